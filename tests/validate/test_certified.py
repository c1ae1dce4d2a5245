"""Every rectangle of a renderer has a certificate; an error in a further one loses the bar."""

import math

import numpy as np
import pytest
from optics.made import StubCamera, bank, scene, sensor, shapes

from gpusim.plan import Accuracy
from gpusim.validate import certified
from gpusim.validate.certified import certificate_bar, certificate_section, certificates_of

TILES = [(0, 0, 24, 24), (24, 8, 24, 24)]
TOLERANCE = 1e-2


@pytest.mark.parametrize("planted", [False, True])
def test_a_further_rectangle_is_certified_by_probes_of_its_own(monkeypatch, planted):
    def go_on(renderer, first, probes, go_on=certified.go_on):
        go_on(renderer, first, probes)
        # The exact model's glare is this: its truth is a twentieth of the mean brighter.
        renderer.glare = renderer.glare + np.float32(0.05 * first.rate.mean())

    if planted:
        monkeypatch.setattr(certified, "go_on", go_on)
    camera, subject = StubCamera(bank(size=32, circle_um=60.0), sensor(32, 48)), scene(shapes())
    found = certified.certified_tiles(camera, subject, Accuracy(TOLERANCE, 4), 0.01, TILES)
    first, other = (one.certificate for one in found)
    assert first.probes == other.probes == 4
    assert (other.bank_rms, other.window) == (first.bank_rms, first.window)
    assert first.met and certificate_bar(certificates_of({"first": found[0]}, TOLERANCE)).held
    made = {"both": certified.pooled(found, TOLERANCE)}
    whole = made["both"].certificate
    assert whole.probes == 8 and whole.met is not planted
    assert whole.total_rms == pytest.approx(math.hypot(first.total_rms, other.total_rms) / 2**0.5)
    assert whole.total_worst == max(first.total_worst, other.total_worst)
    assert certificate_bar(made).held is not planted
    rows = certificate_section(made, {"another": "it is the same"}).rows.body
    assert [row[0] for row in rows] == ["both", "another"]
    assert rows[1][1] == "none: it is the same"
