"""PSFs of the Kodak report are those of rays that are summed directly; a defocus is seen."""

import math

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from gpusim.lens.system import build
from gpusim.validate import kodak, kodak_psf
from gpusim.validate.predict import Predictor
from gpusim.validate.tracers import OwnTracer, refracted_losses


@pytest.fixture(scope="module")
def measured():
    lens = kodak.stand_in()
    system, nodes = build(lens), np.array([540.0, 550.0, 560.0, 570.0])
    widest = math.radians(lens.max_field_deg)
    with threadpool_limits(1):
        losses = refracted_losses(system, nodes)
        predictor = Predictor(OwnTracer(system), widest, nodes, losses, pupils=7)
    return lens, predictor


def test_psfs_lie_where_the_rays_have_them(measured):
    found = kodak_psf.measure_psfs(*measured)
    assert [one.where for one in found.found] == ["centre", "mid-field", "corner"]
    assert all(bar.held for bar in found.bars()), found.bars()
    # Coma: outwards is not inwards.
    corner = found.found[2]
    turned = kodak_psf.PointSpread("turned", 0.0, corner.own[:, ::-1], corner.predicted)
    assert turned.elsewhere > 10 * kodak_psf.BAR


def test_a_defocus_of_two_micrometres_is_seen(measured):
    lens, predictor = measured
    found = kodak_psf.measure_psfs(lens.defocused(2.0), predictor)
    assert not any(bar.held for bar in found.bars()), found.bars()
