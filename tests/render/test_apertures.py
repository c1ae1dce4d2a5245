"""Pixels that see light in other places than a square in their middle, against the exact model."""

from __future__ import annotations

import numpy as np
import pytest
from changes import sensor_file
from harness import assert_close
from optics.made import StubCamera, bank, monochrome, scene, shapes
from sampling import one_in

from gpusim.errors import UserError
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.sensor.aperture import Aperture, Part, Response, transfer_along
from gpusim.sensor.load import load_sensor
from gpusim.sensor.sensor import Sensor

LENS = bank(coma_um=0.6, falloff=0.1, halo=0.1)
ASIDE = Aperture(rectangles=[Part(x=0.1, y=0.3, width=0.5, height=0.7)])
L_SHAPE = Aperture(
    rectangles=[
        Part(x=0.0, y=0.0, width=1.0, height=0.5),
        Part(x=0.0, y=0.5, width=0.4, height=0.5),
    ]
)
MEASURED = Aperture(map=[[0.2, 0.8, 0.4], [0.6, 1.0, 0.0]])
CASES = {
    "a rectangle aside": {"aperture": ASIDE},
    "an L": {"aperture": L_SHAPE},
    "a measured map": {"aperture": MEASURED},
    "a scan to the side": {"scan_motion_px": (2.5, 0.0)},
    "an L in a slanting scan": {"aperture": L_SHAPE, "scan_motion_px": (0.8, -1.5)},
}


def of_case(changes: dict, rows: int = 32, cols: int = 44) -> Sensor:
    aperture = changes.get("aperture")
    fill = aperture.area if aperture else 0.64
    return monochrome(rows, cols, fill_factor=fill, **changes)


def certified(changes: dict, method: str, judged_as: dict | None = None):
    camera = StubCamera(LENS, of_case(changes))
    renderer = Renderer(camera, scene(shapes()), Accuracy(3e-3, 12), method=method)
    try:
        if judged_as is not None:  # after the plan and the kernels: a planted error
            renderer.camera = StubCamera(LENS, of_case(judged_as))
        return renderer.capture(0.01).certificate
    finally:
        renderer.release()


@pytest.mark.parametrize("name", one_in(2, CASES))
def test_any_aperture_meets_the_certificate(name: str):
    assert certified(CASES[name], "fft").met


@pytest.mark.parametrize("method", ["direct", "modes"])
def test_every_method_knows_it(method: str):
    assert certified(CASES["an L in a slanting scan"], method).met


def test_the_certificate_sees_a_mirrored_aperture():
    mirrored = Aperture(rectangles=[Part(x=0.4, y=0.3, width=0.5, height=0.7)])
    assert not certified({"aperture": mirrored}, "fft", {"aperture": ASIDE}).met
    straight = certified({"scan_motion_px": (2.5, 0.0)}, "fft", {"scan_motion_px": (0.0, 2.5)})
    assert not straight.met


def test_the_transform_is_that_of_the_response():
    """Against sums over the pixel; rectangles are sincs, a motion one more."""
    pixel = of_case(CASES["an L in a slanting scan"]).response_um / 1.55
    places, shares = pixel.points(0.05)
    assert shares.sum() == pytest.approx(1, abs=1e-12)
    fx, fy = np.array([0.0, 0.3, -0.7, 1.1]), np.array([0.0, 0.2, 0.4, -0.9])
    found = pixel.spectrum(fx, fy)
    waves = np.exp(2j * np.pi * (np.outer(fx, places[:, 0]) + np.outer(fy, places[:, 1])))
    assert_close(found, waves @ shares, atol=1e-9)
    assert found[0] == 1
    assert np.abs(found - found.conj()).max() > 0.1  # it lies aside


def test_a_square_given_as_a_rectangle_is_the_square():
    square = Aperture(rectangles=[Part(x=0.1, y=0.1, width=0.8, height=0.8)])
    given, plain = of_case({"aperture": square}), of_case({})
    f = np.linspace(0, 2, 50)
    for axis in (0, 1):
        one = transfer_along(given.response_um, f, axis)
        assert_close(one, np.abs(transfer_along(plain.response_um, f, axis)), atol=1e-12)
    assert isinstance(given.response_um, Response)
    assert plain.response_um == pytest.approx(1.55 * 0.8)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"aperture": {"rectangles": [{"x": 0.5, "y": 0, "width": 0.6, "height": 1}]}}, "out of"),
        (
            {
                "aperture": {
                    "rectangles": [
                        {"x": 0, "y": 0, "width": 0.6, "height": 1},
                        {"x": 0.5, "y": 0, "width": 0.5, "height": 1},
                    ]
                }
            },
            "overlap",
        ),
        ({"aperture": {"map": [[0.5, 1.2]]}}, "response that is none"),
        ({"aperture": {"map": [[0.0, 0.0]]}}, "response that is none"),
        ({"aperture": {"map": [[0.5, 1.0], [1.0]]}}, "no rectangle"),
        ({"aperture": {}}, "rectangles or a map"),
        ({"aperture": {"map": [[0.5, 0.5]]}}, "another area"),
        ({"scan_motion_px": [3, 3]}, "too far"),
    ],
)
def test_wrong_apertures_are_named(tmp_path, changes, said):
    with pytest.raises(UserError, match=said) as caught:
        load_sensor(sensor_file(tmp_path, **changes))
    assert caught.value.allowed and caught.value.field.startswith(("aperture", "fill", "scan"))
