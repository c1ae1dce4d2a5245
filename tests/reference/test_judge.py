"""Renders against a judge that shares no bank with them, and against the MTF of the pupil.

`tools/matrix.py` does the same over many lenses; here is a sample of it, and behind the marker
``slow`` more.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from gpusim.camera import Camera, load_camera
from gpusim.formats.lens_file import load_prescription
from gpusim.lens.system import build, first_order, transmission
from gpusim.plan import Accuracy
from gpusim.psf.otf import field_pupils
from gpusim.reference.backward import chief_back, trace_back
from gpusim.reference.lens_truth import Judge
from gpusim.reference.lens_view import REFERENCE_NM, view
from gpusim.render import Renderer
from gpusim.scene.chart import Chart, Rect
from gpusim.scene.make import make_scene
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM, white_radiance

LINES_NM = np.linspace(400.0, 700.0, 9)
TOLERANCE = 1e-3
WHITE, BLACK = 0.8, 0.05
# One row of pixels crosses an edge at 20 phases: 2.9 degrees, of which the other direction's MTF
# gets sin^2 = 0.25 % in the slanted one's place, at most 1e-3 where the two differ by 0.4.
SLANT = math.atan(1 / 20)
FREQUENCIES_CY_PX = np.array([0.1, 0.25, 0.5])
TILE = (160, 80)  # pixels across an edge and along it


def camera_of(name: str, focal_mm: float, f_number: float, field_deg: float) -> Camera:
    """Return a lens before a monochrome sensor without veiling glare, as wide as its circle."""
    lens = load_prescription(name).scaled(focal_mm).stopped(f_number).limited(field_deg)
    sensor = load_camera("machine-vision").sensor.model_copy(update={"veiling_glare": 0.0})
    return Camera(lens, sensor, name)


def render(camera: Camera, scene: Scene, tile: tuple[int, int, int, int]) -> np.ndarray:
    """Return electrons/s of a tile (x, y, width, height)."""
    renderer = Renderer(camera, scene, Accuracy(TOLERANCE, 0), noise=False)
    try:
        return renderer.capture(0.01, tile=tile, keep=("rate",)).rate.astype(float)
    finally:
        renderer.release()


def scene_of(camera: Camera, *shapes: Rect) -> Scene:
    """Return black shapes, um on the ideal plane, on white."""
    half_um = camera.sensor.rows * camera.sensor.pixel_pitch_um / 2
    chart = Chart(("white", "black"), 0, shapes).placed(1 / half_um)
    white = white_radiance("D50", 300.0)
    return Scene("shapes", np.multiply.outer([WHITE, BLACK], white), chart, "D50", white)


class Place:
    """A point of a camera's image, by pixel, and the plane that it looks at."""

    def __init__(self, camera: Camera, share_x: float, share_y: float) -> None:
        sensor = camera.sensor
        self.camera, self.system = camera, build(camera.lens)
        self.col = int(sensor.cols / 2 * (1 + share_x))
        self.row = int(sensor.rows / 2 * (1 + share_y))
        self.ideal_um = self.looks_at(0.0, 0.0)

    def looks_at(self, right_px: float, down_px: float) -> np.ndarray:
        """Return the ideal plane's point, um, of a pixel's middle so far away."""
        sensor, system = self.camera.sensor, self.system
        at = np.array([self.col + right_px, self.row + down_px]) + 0.5
        image = (at - np.array([sensor.cols, sensor.rows]) / 2) * sensor.pixel_pitch_um * 1e-3
        index = system.index(np.array([REFERENCE_NM]))
        chief = trace_back(system, index, image[:, None], chief_back(system, index, image))
        x, y, z = chief.direction[:, 0]
        focal_um = 1e3 * first_order(system.prescription, REFERENCE_NM).efl_mm
        return focal_um * np.array([x / z, y / z])

    def edge(self, radial: bool, off_px: float = 0.0) -> Rect:
        """Return a square whose near side passes by the point: across the radius x, or along it."""
        middle = self.ideal_um
        step = np.stack([self.looks_at(1, 0) - middle, self.looks_at(0, 1) - middle])
        half = 400 * float(np.hypot(*step[0]))
        # The side that faces left, or up: its outward normal, and where it passes.
        angle = SLANT if radial else SLANT + np.pi / 2
        normal = np.array([math.cos(angle), math.sin(angle)])
        past = off_px * float(np.hypot(*step[0 if radial else 1]))
        centre = middle + (half + past) * normal
        return Rect(float(centre[0]), float(centre[1]), half, half, angle, 1)


@pytest.fixture(scope="module")
def machine_vision():
    return camera_of("double-gauss", 25.0, 5.6, 16.5)


def judged(place: Place, scene: Scene, rows: list[int], cols: list[int]) -> np.ndarray:
    """Return render over judge, less 1, at pixels off the place's own."""
    camera = place.camera
    tile = render(camera, scene, (place.col - 16, place.row - 16, 32, 32))
    judge = Judge(place.system, camera.sensor, scene, WAVELENGTHS_NM)
    found = []
    for row, col in zip(rows, cols, strict=True):
        at = place.row + row, place.col + col
        truth = judge.pixel(view(place.system, judge.point_um(*at), LINES_NM), *at)
        found.append(tile[16 + row, 16 + col] / truth.rate - 1)
    return np.array(found)


@pytest.mark.slow
def test_an_even_scene_is_what_the_judge_sees(machine_vision):
    place = Place(machine_vision, 0.8, 0.8)
    errors = judged(place, scene_of(machine_vision), [0], [0])
    # Its relative illumination is straight between the bank's fields: 2e-4 here.
    assert np.abs(errors).max() < TOLERANCE


def test_pixels_beside_an_edge_are_what_the_judge_sees(machine_vision):
    place = Place(machine_vision, 0.8, 0.8)
    scene = scene_of(machine_vision, place.edge(radial=True))
    errors = judged(place, scene, [0, 2, -2], [0, 4, 10])
    # Twice: an RMS over three pixels exceeds 2.3 times that of all in one case of a thousand.
    assert np.sqrt(np.mean(errors**2)) < 2.3 * TOLERANCE


def places_seen(
    place: Place, corner: tuple[int, int], shape: tuple[int, int]
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the ideal plane's x and y, um, of a tile's pixels, by the map around the place.

    And how they change with a pixel to the right and down, at the place: (x and y, both ways).
    """
    rows, cols = shape
    ways = (np.array([cols / 2, 0.0]), np.array([0.0, rows / 2]))
    ends = [(place.looks_at(*one), place.looks_at(*-one), one.sum()) for one in ways]
    step = np.stack([(ahead - behind) / (2 * far) for ahead, behind, far in ends], axis=1)
    bend = [(ahead + behind - 2 * place.ideal_um) / (2 * far**2) for ahead, behind, far in ends]
    down, right = np.indices(shape)
    right, down = right + corner[0] - place.col, down + corner[1] - place.row
    ideal = [
        place.ideal_um[k]
        + step[k, 0] * right
        + step[k, 1] * down
        + bend[0][k] * right**2
        + bend[1][k] * down**2
        for k in (0, 1)
    ]
    return ideal, step


def sfr(place: Place, radial: bool) -> np.ndarray:
    """Return the SFR of a rendered edge at FREQUENCIES_CY_PX, ISO 12233's way, on exact places."""
    camera = place.camera
    across, along = TILE
    width, height = (across, along) if radial else (along, across)
    corner = (place.col - width // 2, place.row - height // 2, width, height)
    shape = place.edge(radial)
    with_edge, even = (
        render(camera, scene_of(camera, *shapes), corner) for shapes in ((shape,), ())
    )
    ideal, step = places_seen(place, corner, with_edge.shape)
    # Each pixel's distance to the edge in the image, pixels.
    distance = -shape.distance(*ideal)
    normal = np.array([math.cos(shape.angle_rad), math.sin(shape.angle_rad)])
    scale = np.hypot(*(step.T @ normal))  # um on the ideal plane for a pixel across the edge
    d = (distance / scale).ravel()
    edge = ((1 - with_edge / even) / (1 - BLACK / WHITE)).ravel()
    used = np.abs(d) < across / 2 - 8
    order = np.argsort(d[used])
    d, edge = d[used][order], edge[used][order]
    # The transform of the derivative, by parts: 1 of a step, and 2 pi i f times that of the rest.
    middle = np.interp(0.0, d, edge)
    left = d <= 0
    places = np.concatenate([d[left], [0.0, 0.0], d[~left]])
    rest = np.concatenate([edge[left], [middle, middle - 1], edge[~left] - 1])
    f = FREQUENCIES_CY_PX
    waves = np.exp(-2j * np.pi * f[:, None] * places)
    return np.abs(1 + 2j * np.pi * f * np.trapezoid(rest * waves, places, axis=1))


def of_pupil(
    place: Place,
    radial: bool,
    cycles_px: np.ndarray = FREQUENCIES_CY_PX,
    slant: float = SLANT,
) -> np.ndarray:
    """Return the polychromatic MTF of the pupil times the pixel's aperture."""
    camera, system = place.camera, place.system
    x, y = place.ideal_um
    focal_um = 1e3 * first_order(system.prescription, REFERENCE_NM).efl_mm
    theta = math.atan(math.hypot(x, y) / focal_um)
    light = white_radiance("D50", 300.0) * transmission(system.prescription, WAVELENGTHS_NM)
    light = light * camera.sensor.qe["W"] * WAVELENGTHS_NM
    lines, light = WAVELENGTHS_NM[::3], light[::3]
    light[[0, -1]] /= 2  # the trapezoidal rule: with whole ends the MTF is 0.007 less
    pupils = field_pupils(system, theta, lines, light, reference=10)
    pitch_um = camera.sensor.pixel_pitch_um
    found = pupils.otf(1e3 * cycles_px / pitch_um, "tangential" if radial else "sagittal")
    f = cycles_px * math.sqrt(camera.sensor.fill_factor)
    return np.abs(found) * np.sinc(f * math.cos(slant)) * np.sinc(f * math.sin(slant))


def test_an_edge_has_the_mtf_of_the_pupil_times_the_pixels(machine_vision):
    place = Place(machine_vision, 0.85, 0.0)
    assert sfr(place, True) == pytest.approx(of_pupil(place, True), abs=0.005)


def modulations(folder: Path, place: Place, radial: bool, period_px: float) -> tuple[float, float]:
    """Return the modulation of rendered waves over the chart's, and the one of MTF and aperture.

    They are slanted: at 2 pixels a period, rows of upright ones have one phase each.
    """
    camera = place.camera
    slant = SLANT if radial else SLANT + np.pi / 2
    path = folder / "waves.yaml"
    path.write_text(
        "title: waves\nunit: pixels\nbackground: 0.2\n"
        f"pattern: {{pattern: sinusoid, period: {period_px}, angle_deg: {math.degrees(slant)}, "
        f"fills: [{BLACK}, {WHITE}]}}\n"
    )
    white = white_radiance("D50", 300.0)  # from 400 to 700 nm, as the pupil's
    source = make_scene(path, frame=camera.frame).source
    scene = Scene("waves", white[None], source, "D50", white)
    corner = place.col - 48, place.row - 48
    seen = render(camera, scene, (*corner, 96, 96))
    # The image plane of best focus shows them as much larger as it lies behind the paraxial one,
    # and distortion as it does.
    ideal, step = places_seen(place, corner, seen.shape)
    normal = np.array([math.cos(slant), math.sin(slant)])
    period_um = period_px * camera.sensor.pixel_pitch_um
    angle = 2 * np.pi / period_um * np.tensordot(normal, ideal, axes=1)
    down, right = np.indices(seen.shape) - 48
    shade = np.ones(seen.shape), right, down
    waves = np.stack([*shade, np.cos(angle), np.sin(angle)], axis=-1).reshape(-1, 5)
    even, _, _, *wave = np.linalg.lstsq(waves, seen.ravel(), rcond=None)[0]
    modulation = np.hypot(*wave) / even / ((WHITE - BLACK) / (WHITE + BLACK))
    cycles_px = np.hypot(*(step.T @ normal)) / period_um
    (expected,) = of_pupil(place, radial, np.array([cycles_px]))
    return float(modulation), float(expected)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "radial", "period_px"),
    [(0.0, True, 2.0), (0.0, True, 8.0), (0.85, True, 2.0), (0.85, False, 3.0)],
    ids=["axis, 2 px", "axis, 8 px", "radial, 2 px", "azimuthal, 3 px"],
)
def test_waves_have_the_amplitude_of_the_mtf(machine_vision, tmp_path, share, radial, period_px):
    found, expected = modulations(tmp_path, Place(machine_vision, share, 0.0), radial, period_px)
    assert found == pytest.approx(expected, abs=0.003)


@pytest.mark.slow
@pytest.mark.parametrize("radial", [True, False], ids=["radial", "azimuthal"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.85], ids=["axis", "half", "corner"])
@pytest.mark.parametrize(
    "lens",
    [("double-gauss", 25.0, 5.6, 16.5), ("tessar", 20.0, 5.6, 20.0), ("telephoto", 45.0, 5.6, 9.0)],
    ids=lambda lens: lens[0],
)
def test_edges_have_the_mtf_of_the_pupil_times_the_pixels(lens, share, radial):
    place = Place(camera_of(*lens), share, 0.0)
    assert sfr(place, radial) == pytest.approx(of_pupil(place, radial), abs=0.005)
