"""Where highlights land: found once for every model of a bank."""

from concurrent.futures import ThreadPoolExecutor
from time import sleep

import numpy as np
from optics.made import bank

from gpusim.reference.fields import Heights
from gpusim.reference.landing import Landings, landed
from gpusim.scene.highlights import Highlights


def test_highlights_land_once_for_all_models_of_a_bank(monkeypatch):
    """Threads that ask at once wait for the first; other highlights, or other nodes, land anew."""
    asked = []

    def counted(fields, ideal):
        asked.append(len(ideal))
        sleep(0.05)
        return landed(fields, ideal)

    monkeypatch.setattr("gpusim.reference.landing.landed", counted)
    landings = Landings(Heights(bank()))
    lamps, other = (
        Highlights(centre_um=np.array([[20.0, y]]), size_um=2.0, excess=np.ones((1, 2)))
        for y in (12.0, -5.0)
    )
    line, shares = np.array([-0.5, 0.5]), np.ones(2)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: landings.of(lamps, line, shares), range(4)))
    assert asked == [4]
    real, areas = found[0]
    assert real.shape == (1, 4, 2) and areas.shape == (1, 4)
    assert all(one[0] is real for one in found)
    landings.of(lamps, np.array([0.0]), np.full(1, 2.0))
    moved = landings.of(other, line, shares)[0]
    assert asked == [4, 1, 4]
    assert np.hypot(*(moved - real).reshape(-1, 2).T).min() > 10
