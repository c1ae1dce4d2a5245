"""Small lenses and pupils with closed forms."""

from pathlib import Path

import numpy as np

from gpusim.lens.checks import checked
from gpusim.lens.model import APERTURES
from gpusim.lens.prescription import Prescription, validated
from gpusim.lens.samples import Samples


def lens(surfaces, **fields):
    """Return a prescription from rows of surface fields; f/5 over 5 deg unless told otherwise."""
    data = {
        "title": "test lens",
        "patent": None,
        "source": "made up",
        "units": "mm",
        "max_field_deg": 5.0,
        "focus": "paraxial",
        "stop": 1,
        "surfaces": surfaces,
    }
    if not set(APERTURES) & set(fields):
        data["f_number"] = 5.0
    return validated(data | fields, Path("test.yaml"))


def model(nd):
    """Return a glass that hardly disperses: the largest Abbe number that the model allows."""
    return {"glass": "model", "nd": nd, "vd": 149.0}


def fisheye(**fields):
    """Return a crude fisheye that sees 105 deg off its axis: two menisci before one lens."""
    rows = [
        {"radius": 15.0, "thickness": 1.0, **model(1.8)},
        {"radius": 6.0, "thickness": 3.5},
        {"radius": 40.0, "thickness": 0.8, **model(1.6)},
        {"radius": 3.5, "thickness": 6.0},
        {"radius": np.inf, "thickness": 0.5},
        {"radius": 12.0, "thickness": 2.0, **model(1.6)},
        {"radius": -3.6},
    ]
    return lens(rows, **{"stop": 5, "f_number": 8.0, "max_field_deg": 105.0} | fields)


class EvenLight:
    """Light that enters evenly in direction cosines, as before a lens that obeys the sine rule."""

    def density(self, line, kept):
        """Return ones, and 1 of the chief ray."""
        return np.ones(int(kept.sum())), 1.0


def disc_samples(half_width, beta_centre=0.0, opd=lambda a, b: 0.0 * a):
    """Return rays of a synthetic pupil: a disc in direction cosines, W(alpha, beta) in mm."""
    u, v = np.meshgrid(np.linspace(0, 1.04, 41), np.linspace(-1.04, 1.04, 81))
    keep = u * u + v * v <= 1.04**2
    u, v = u[keep], v[keep]
    alpha, beta = half_width * u, beta_centre + half_width * v
    nothing = np.zeros((1, alpha.size))
    return Samples(
        chief_x_mm=np.zeros(1),
        chief_y_mm=np.zeros(1),
        chief_direction=np.array([[0.0, beta_centre]]),
        alpha=alpha[None],
        beta=beta[None],
        opd_mm=opd(alpha, beta)[None],
        landing_x_mm=nothing,
        landing_y_mm=nothing,
        margin=(u * u + v * v - 1)[None, None],
        ok=np.ones((1, alpha.size), dtype=bool),
        entering=EvenLight(),
    )


def failed_checks(prescription: Prescription) -> list[str]:
    """Return one sentence for each figure of the source that the lens does not reproduce."""
    return [
        f"{one.check.quantity} ({one.check.indices} indices) is {one.found:.6g}, the source says "
        f"{one.check.value:g} +- {one.check.tolerance:g}"
        for one in checked(prescription)
        if not one.met
    ]
