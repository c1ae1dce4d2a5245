"""A session redoes what a change touches, and no more; what it shows is what a render shows."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from optics.made import bank, scene, sensor, shapes

from gpusim.camera import Camera
from gpusim.errors import UserError
from gpusim.library.expose import expose
from gpusim.library.session import Session

MADE = sensor(32, 40)
SCENE = scene(shapes())


@dataclass(frozen=True)
class StubLens:
    """A lens that can be stopped down and moved: each time another bank."""

    width: float = 1.0
    title: str = "Gaussians"

    def bank(self, progress: object = None):
        """Return its Gaussians."""
        return bank(coma_um=0.6, sigma_um=tuple(self.width * s for s in (0.95, 1.0, 1.15)))

    def stopped(self, f_number: float):
        """Return it with other Gaussians."""
        if f_number < 1:
            raise UserError("too wide", field="f_number", value=f_number, allowed="1 or more")
        return StubLens(self.width * f_number / 2)

    def defocused(self, shift_um: float):
        """Return it with wider Gaussians."""
        return StubLens(self.width + abs(shift_um) / 10)


@pytest.fixture
def session():
    with Session(Camera(StubLens(), MADE), SCENE, tolerance=1e-2) as made:
        yield made


def test_each_change_redoes_what_it_touches(session: Session):
    session.frame()
    assert session.redone == ("plan", "light", "read-out")
    session.frame()
    assert session.redone == ()
    for change in ({"exposure_s": 0.01}, {"seed": 5}, {"temperature_c": 40.0}, {"noise": False}):
        session.change(**change).frame()
        assert session.redone == ("read-out",), change
    session.change(tile=(4, 4, 16, 16)).frame()
    assert session.redone == ("light", "read-out")
    noisier = MADE.model_copy(update={"temporal_dark_noise_e": 9.0})
    session.change(sensor=noisier).frame()
    assert session.redone == ("read-out",)
    for change in ({"f_number": 3.0}, {"scene": scene(shapes())}, {"tolerance": 2e-2}):
        session.change(**change).frame()
        assert session.redone == ("plan", "light", "read-out"), change


def test_what_it_shows_is_what_a_render_shows(session: Session):
    session.frame()
    shown = session.change(f_number=3.0, exposure_s=0.02, seed=7).frame()
    light = expose(Camera(StubLens(1.5), MADE), SCENE, 1e-2, probes=0)
    assert shown.raw.tobytes() == light.capture(0.02, seed=7).raw.tobytes()
    part = session.change(tile=(4, 6, 16, 12)).frame()
    assert part.raw.tobytes() == shown.raw[6:18, 4:20].tobytes()


def test_a_setting_is_taken_back(session: Session):
    first = session.frame().raw.tobytes()
    session.change(f_number=4.0, exposure_s=0.5, seed=3).frame()
    back = session.change(f_number=None, exposure_s=None, seed=None).frame()
    assert back.raw.tobytes() == first


@pytest.mark.parametrize(
    "change, field",
    [
        ({"f_stop": 4.0}, "f_stop"),
        ({"f_number": 0.5}, "f_number"),
        ({"tile": (0, 0, 99, 99)}, "tile"),
        ({"tolerance": 5.0}, "tolerance"),
    ],
)
def test_a_change_that_cannot_be_changes_nothing(session: Session, change: dict, field: str):
    before = session.frame().raw.tobytes()
    with pytest.raises(UserError) as error:
        session.change(seed=9, **change)
    assert error.value.field == field
    assert session.frame().raw.tobytes() == before and session.redone == ()
