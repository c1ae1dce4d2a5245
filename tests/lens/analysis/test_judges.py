"""Analyses against optiland's, of the same lens with the same indices; skipped where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from lens.test_judges import GREEN_NM, Optiland, our_system

from gpusim.lens.analysis.fields import Field, rays_at
from gpusim.lens.analysis.focus import field_focus
from gpusim.lens.analysis.rays import spot_diagram, wavefront_map
from gpusim.lens.analysis.zernike import fit

pytestmark = pytest.mark.slow
GREEN = np.array([GREEN_NM])
CASES = [("cooke-triplet", 14.0), ("telephoto", 6.0), ("tessar", 10.0)]


@pytest.fixture(params=CASES, ids=lambda case: case[0], scope="module")
def case(request: pytest.FixtureRequest):
    pytest.importorskip("optiland")
    name, field_deg = request.param
    system, index = our_system(name)
    return system, Optiland(system, index, field_deg), np.radians(field_deg)


def test_field_curvature(case):
    from optiland.analysis import FieldCurvature

    system, judge, edge = case
    tangential, sagittal = FieldCurvature(judge.optic, num_points=9).data[0]
    found = field_focus(system, GREEN, np.linspace(0, edge, 9))[:, 0]
    # Both by close rays: theirs at 1e-5 of the pupil, ours at 1e-3, whose square counts.
    np.testing.assert_allclose(found, np.transpose([tangential, sagittal]), rtol=0, atol=5e-6)
    assert np.abs(found).max() > 0.02


def test_zernike_terms(case):
    from optiland.wavefront import ZernikeOPD

    system, judge, theta = case
    options = {"num_rings": 32, "zernike_type": "noll", "num_terms": 37}
    theirs = ZernikeOPD(judge.optic, judge.field, GREEN_NM * 1e-3, **options)
    expected = np.ravel(np.array(theirs.zernike.coeffs, float))[1:]
    field = Field("", theta)
    wave = wavefront_map(system, GREEN_NM, field)
    lit = np.isfinite(wave.opd_waves)
    x, y = (grid[lit] for grid in np.meshgrid(wave.stop, wave.stop))
    # Their sphere ends at the exit pupil: see tests/lens/test_judges.py.
    rays = rays_at(system, GREEN, field, x, y)
    p, d = (
        np.stack(pair)
        for pair in ((rays.landing_x_mm[0], rays.landing_y_mm[0]), (rays.alpha[0], rays.beta[0]))
    )
    radius = abs(judge.rays(np.zeros(1), np.zeros(1)).radius)
    more = radius - np.sqrt(radius**2 - (p * p).sum(0) + (p * d).sum(0) ** 2)
    found = fit(wave.opd_waves[lit] - more / (1e-6 * GREEN_NM), x, y)[1:]
    # Theirs weigh the rim more, which counts where 37 terms leave something out.
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-3)
    assert np.abs(expected).max() > 0.1


def test_spots(case):
    from optiland.analysis import SpotDiagram

    system, judge, theta = case
    # Many rings: theirs weigh each ray the same, also those of the rim.
    theirs = SpotDiagram(judge.optic, num_rings=80, distribution="hexapolar")
    found = spot_diagram(system, GREEN, 0, Field("", theta))
    assert found.rms_um == pytest.approx(1e3 * np.ravel(theirs.rms_spot_radius())[0], rel=0.03)
