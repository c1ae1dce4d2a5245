"""Cases of scene, lens and optics: PSFs, distortion, dynamic range, sizes, bad input."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from gpusim.camera import load_camera
from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.formats.ready import load_ready
from gpusim.gpu import default_device
from gpusim.lens.projection import ANGULAR
from gpusim.lens.samples import sample_field
from gpusim.lens.system import build
from gpusim.lens.wavefront import pupils
from gpusim.plan import Accuracy
from gpusim.psf.bank import Bank
from gpusim.psf.field_map import FieldMap
from gpusim.psf.generator import Generator
from gpusim.psf.psf import intensity
from gpusim.psf.sampling import default_pitch_um
from gpusim.render import Renderer
from gpusim.scene import make_scene
from gpusim.scene.chart import Chart
from gpusim.scene.exr import write_exr
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene
from gpusim.sensor.load import load_sensor
from gpusim.stress.made import (
    FLAT,
    camera_of,
    certified_case,
    compared,
    edge_case,
    edge_profile,
    edge_scene,
    gaussian_bank,
    mono,
    rate_of,
    white_rate,
)
from gpusim.stress.table import REFUSED, Case, Engine, short


def psf_below_a_sample() -> tuple:
    """Take a PSF of 0.2 um, a quarter of a sim pixel of 0.775 um."""
    return edge_case(
        gaussian_bank((0.2, 0.2), pitch_um=0.1, size=64), 0.2, bound=1e-2, tolerance=1e-2
    )


def psf_wider_than_a_tile() -> tuple:
    """Take a PSF that is wider than the image, in tiles of 24 pixels; and these change nothing."""
    bank, sensor = gaussian_bank((12.0, 12.0), size=256), mono(48, 48)
    camera, scene = camera_of(bank, sensor), edge_scene(0.1)
    whole = rate_of(camera, scene)
    same = np.array_equal(whole, rate_of(camera, scene, tile_px=24))
    expected = edge_profile(0.1 * 24 * sensor.pixel_pitch_um, 12.0, sensor)
    middle = whole[24] / white_rate(bank, sensor)
    # The window of 128 um cuts a Gaussian of 12 um at 5.3 sigma: 1e-7.
    what, got, right = compared(middle, expected, 3e-3, "normal law; tiles change no bit")
    return what, got + ("" if same else "; tiles differ"), right and same


def one_wavelength() -> tuple:
    """Take a bank of a single wavelength."""
    return edge_case(gaussian_bank(wavelengths=1), 1.0)


def one_field() -> tuple:
    """Take a bank of a single field: nothing says how far it reaches."""
    bank = gaussian_bank(fields=2)
    parts = {
        name: getattr(bank, name)[:1]
        for name in (
            *("field_deg", "ideal_height_um", "real_height_um", "relative_illumination", "psf"),
            *("outside_energy", "folded_energy", "fit_residual_waves", "failed_rays"),
        )
    }
    return saved(replace(bank, **parts), "2 fields or more")


def one_node() -> tuple:
    """Take a lens alike over the field, as loosely as can be: one cell between PSF nodes."""
    return edge_case(gaussian_bank(), 1.0, 24, 32, bound=1e-2, tolerance=1e-1)


def one_sided_pupil() -> tuple:
    """Leave a fifth of the light at the rim, in a PSF three times as wide across as along."""
    bank = gaussian_bank((2.4, 0.8), rim_illumination=0.2, circle_um=90.0)
    return certified_case(bank, mono(72, 88), edge_scene(0.6), 3e-3)


def near_fold() -> tuple:
    """Take barrel distortion whose stretch falls to a tenth at the rim: r (1 - 0.3 (r/R)^2)."""
    bank = gaussian_bank(
        real_over_ideal=lambda r: 1 - 0.3 * (r / 150.0) ** 2, fields=31, circle_um=150.0
    )
    return certified_case(bank, mono(72, 96), edge_scene(0.8), 1e-2)


def beyond_fold() -> tuple:
    """Take distortion that folds the image over: no map from image to scene."""
    bank = gaussian_bank(real_over_ideal=lambda r: 1 - 0.5 * (r / 150.0) ** 2, fields=31)
    theta, efl_um = np.radians(bank.field_deg), 1e3 * bank.efl_mm
    folds = FieldMap(theta, bank.real_height_um[:, 0], efl_um).folds_at
    # d/dr of r - 0.5 r^3 / R^2 is zero at R sqrt(2/3).
    wanted = float(np.degrees(np.arctan(150.0 * np.sqrt(2 / 3) / efl_um)))
    what, got, right = saved(bank, "rising")
    found = "no fold" if folds is None else f"{np.degrees(folds):.3f} deg"
    near = folds is not None and abs(np.degrees(folds) - wanted) < 0.05
    return (
        f"fold at {wanted:.3f} deg; {what}",
        f"{found}; {got}",
        REFUSED if right and near else False,
    )


def fisheye(rim_deg: float) -> Callable[[], tuple]:
    """Return the case of a lens with r = f theta: an edge lands where its chief ray does."""

    def case() -> tuple:
        # So long that the image circle holds the sensor.
        focal_um = max(150.0 / np.tan(np.radians(rim_deg)), 45.0)
        bank = gaussian_bank(
            real_over_ideal=lambda r: np.where(
                r > 0, focal_um * np.arctan(r / focal_um) / np.maximum(r, 1e-9), 1.0
            ),
            circle_um=focal_um * np.tan(np.radians(rim_deg)),
            fields=int(rim_deg) + 1,
            efl_mm=focal_um / 1e3,
        )
        sensor = mono(24, 64)
        real_um = 30.0
        ideal_um = focal_um * np.tan(real_um / focal_um)
        position = ideal_um / (12 * sensor.pixel_pitch_um)
        rate = rate_of(camera_of(bank, sensor), edge_scene(position)) / white_rate(bank, sensor)
        # The edge is curved: half a pixel off the axis it lies y^2 / (2 r) = 0.01 um aside, of
        # 0.4/um, and over the PSF's 1 um it is stretched otherwise by a per cent or two.
        expected = edge_profile(real_um, 1.0, sensor)
        return compared(rate[12], expected, 1.5e-2, "edge at f theta")

    return case


def fisheye_beyond_90() -> tuple:
    """Take a lens of 100 degrees off the axis and a scene that goes on behind the camera."""
    focal_um, angles = 100.0, np.linspace(0, 100, 41)
    flat = gaussian_bank(fields=41)
    bank = replace(
        flat,
        field_deg=angles,
        ideal_height_um=np.where(angles < 90, focal_um * np.tan(np.radians(angles)), np.inf),
        real_height_um=np.repeat(focal_um * np.radians(angles)[:, None], 3, axis=1),
        efl_mm=focal_um / 1e3,
    )
    sensor = mono(48, 208)
    # At 95 degrees: 165.8 um of real height, as on the angular plane; the sensor ends at 161.2.
    real_um = focal_um * np.radians(85.0)
    position = real_um / (24 * sensor.pixel_pitch_um)
    scene = replace(edge_scene(position), projection=ANGULAR)
    rate = rate_of(camera_of(bank, sensor), scene) / white_rate(bank, sensor)
    expected = edge_profile(real_um, 1.0, sensor)
    return compared(rate[24], expected, 3e-3, "edge at f theta, 85 degrees, on to 92")


def outside_the_circle() -> tuple:
    """Take a sensor whose corners lie outside the image circle."""
    bank, sensor = gaussian_bank(circle_um=45.0), mono(48, 64)
    scene = Scene("white", FLAT[None], Chart(("white",), 0, ()), "E", FLAT)
    row, col = np.indices((48, 64))
    off_um = np.hypot(col + 0.5 - 32, row + 0.5 - 24) * sensor.pixel_pitch_um
    wanted = f"{np.mean(off_um > 45.0):.2%} of its pixels are black"
    renderer = Renderer(camera_of(bank, sensor), scene, Accuracy(1e-2, 0))
    try:
        flags = [one.reason for one in renderer.plan.stages if one.name == "image circle"]
    finally:
        renderer.release()
    return f"flagged: {wanted}", "; ".join(flags), any(wanted in flag for flag in flags)


def beyond_the_circle_is_black() -> tuple:
    """Render it: black beyond the circle, white within."""
    bank, sensor = gaussian_bank(circle_um=45.0), mono(48, 64)
    scene = Scene("white", FLAT[None], Chart(("white",), 0, ()), "E", FLAT)
    rate = rate_of(camera_of(bank, sensor), scene) / white_rate(bank, sensor)
    row, col = np.indices(rate.shape)
    radius = np.hypot(col + 0.5 - 32, row + 0.5 - 24) * sensor.pixel_pitch_um
    # 6 sigma from the circle: what is left of the other side is 1e-9; ringing of the band's end.
    outside, inside = rate[radius > 52.0], rate[radius < 38.0]
    black, even = float(np.abs(outside).max()), float(np.abs(inside - 1).max())
    got = f"{black:.1e} outside, {even:.1e} off inside, of white"
    return "0 outside, 1 inside, to 2e-3", got, black < 2e-3 and even < 2e-3


def principal_point_off_centre() -> tuple:
    """Read a camera file that puts the axis elsewhere than into the sensor's middle."""
    text = (
        "title: off centre\nlens: {prescription: double-gauss, focal_length_mm: 8.3}\n"
        "sensor: {preset: imx477, principal_point_um: [40, 0]}\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "camera.yaml"
        file.write_text(text)
        load_camera(file)
    return "an axis off the centre", "accepted without effect", False


def path_lengths() -> tuple:
    """Trace a double Gauss of 60 mm: paths of 1e5 waves, against float64 ray by ray."""
    line_nm, size = np.array([550.0]), 64
    lens = load_prescription("double-gauss").scaled(60.0).stopped(5.6)
    pitch_um = default_pitch_um(lens, line_nm)
    angles = np.array([0.0, 7.0])
    generator = Generator(
        default_device(), build(lens), line_nm, angles, pitch_um=pitch_um, size=size
    )
    try:
        worst = 0.0
        for field, degrees in enumerate(angles):
            index = generator.system.index(line_nm)
            samples = sample_field(generator.system, index, np.radians(degrees))
            pupil = pupils(samples, line_nm, size * pitch_um, 1024)[0]
            true, _ = intensity(pupil, 550.0, size, pitch_um)
            found = generator.spread(field).psf[0]
            worst = max(worst, float(np.abs(found - true).max() / true.max()))
        waves = generator.system.image_z_mm / 550e-6
    finally:
        generator.release()
    # Naive float32 paths leave 0.02 waves RMS: 2 pi 0.02 = 0.13 in the amplitude, 1.6e-2 of the
    # peak and more beside it. 1e-3 waves leave 4e-5 and 6e-3.
    return f"PSF of float64 to 6e-3 of its peak, at {waves:.1e} waves", f"{worst:.1e}", worst < 6e-3


def even_photograph(rows: int, cols: int, values: np.ndarray) -> tuple:
    """Render an even photograph onto an even lens: every pixel is white."""
    bank, sensor = gaussian_bank(), mono(rows, cols)
    scene = Scene("even", FLAT[None], Raster(values.astype(np.float32)[None]), "E", FLAT)
    rate = rate_of(camera_of(bank, sensor), scene) / white_rate(bank, sensor)
    return compared(rate, np.ones((rows, cols)), 2e-3, "1 everywhere")


def sun_in_the_frame() -> tuple:
    """Where no PSF brings light from the sun, the photograph is as bright as without it."""
    bank, sensor = gaussian_bank(), mono()
    values = np.ones((sensor.rows, sensor.cols), np.float32)
    values[20, 20] = 1e9
    scene = Scene("sun", FLAT[None], Raster(values[None]), "E", FLAT)
    rate = rate_of(camera_of(bank, sensor), scene) / white_rate(bank, sensor)
    row, col = np.indices(rate.shape)
    # The PSFs' window, to its corners, and the texel.
    reach = bank.psf.shape[-1] * bank.pitch_um / np.sqrt(2) / sensor.pixel_pitch_um + 3
    far = np.hypot(row - 20, col - 20) > reach
    expected, got, right = compared(rate[far], np.ones(int(far.sum())), 2e-3, "1 in the shadows")
    least = float(rate.min())
    return f"{expected}, none negative", f"{got}, least {least:.4f}", right and least > 0


def sizes(rows: int, cols: int) -> Callable[[], tuple]:
    """Return the case of a sensor of some size that sees an even field."""

    def case() -> tuple:
        scene = Scene("white", FLAT[None], Chart(("white",), 0, ()), "E", FLAT)
        bank, sensor = gaussian_bank(), mono(rows, cols)
        rate = rate_of(camera_of(bank, sensor), scene) / white_rate(bank, sensor)
        return compared(rate, np.ones((rows, cols)), 2e-3, "1 everywhere")

    return case


def photograph_with(value: float) -> Callable[[], tuple]:
    """Return the case of an EXR file in which one sample is no radiance."""

    def case() -> tuple:
        plane = np.full((4, 6), 0.5, np.float32)
        plane[1, 2] = value
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "scene.exr"
            write_exr(file, {name: plane for name in "RGB"})
            make_scene(file)
        return "refused", "accepted", False

    return case


def no_pixels() -> tuple:
    """Take a region of the sensor without a pixel."""
    load_sensor("imx477").roi(0, 5)
    return "refused", "accepted", False


def saved(bank: Bank, words: str) -> tuple:
    """Say whether a bank that breaks its contract is refused with some words when it is read."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bank.nc"
        bank.save(file)
        try:
            load_ready(file)
        except UserError as error:
            said = error.screen()
            return f"refused: {words}", short(error), REFUSED if words in said else False
    return f"refused: {words}", "accepted", False


def bank_with_nan() -> tuple:
    """Take a bank in which one sample is no number."""
    bank = gaussian_bank(fields=3, size=16)
    psf = bank.psf.copy()
    psf[1, 0, 3, 4] = np.nan
    return saved(replace(bank, psf=psf), "finite numbers")


def bank_without_energy() -> tuple:
    """Take a bank of which one PSF holds no light."""
    bank = gaussian_bank(fields=3, size=16)
    psf = bank.psf.copy()
    psf[1, 0] = 0.0
    return saved(replace(bank, psf=psf), "psf")


def bank_of_odd_size() -> tuple:
    """Take PSFs of an odd number of samples, whose centre is another."""
    bank = gaussian_bank(fields=3, size=17)
    return saved(bank, "even number of samples")


def tolerance_of(text: str) -> Callable[[], tuple]:
    """Return the case of a tolerance that is out of any reach."""

    def case() -> tuple:
        Accuracy.parse(text)
        return "refused", "accepted", False

    return case


def sigma_below_float32() -> tuple:
    """Ask for a thousandth of a sigma at ten million electrons: 3e-7 of the signal."""
    Accuracy(1e-3, 0, "sigma").relative(1e7, 0.0, 1e7)
    return "refused: float32", "accepted", False


def alias_floor() -> tuple:
    """Take a PSF of 0.05 um at a tolerance of 1e-4: the finest sim grid folds more back."""
    bank = gaussian_bank((0.05, 0.05), pitch_um=0.025)
    rate_of(camera_of(bank, mono(24, 24)), edge_scene(0.1), 1e-4)
    return "refused: alias", "accepted", False


CASES: tuple[Case, ...] = (
    ("PSF smaller than a sim pixel", psf_below_a_sample, None),
    ("PSF wider than a tile and the image", psf_wider_than_a_tile, None),
    ("bank with one field", one_field, "fields"),
    ("bank with one wavelength", one_wavelength, None),
    ("lens alike over the field, one cell", one_node, None),
    ("vignetted, one-sided pupil", one_sided_pupil, None),
    ("distortion near fold-over", near_fold, None),
    ("distortion beyond fold-over", beyond_fold, Engine("rising")),
    ("fisheye, 55 degrees", fisheye(55.0), None),
    ("fisheye, 70 degrees", fisheye(70.0), None),
    ("fisheye, 80 degrees", fisheye(80.0), None),
    ("fisheye, beyond 90 degrees", fisheye_beyond_90, None),
    ("sensor outside the image circle", outside_the_circle, None),
    ("black beyond the image circle", beyond_the_circle_is_black, None),
    ("principal point off centre", principal_point_off_centre, Engine("principal_point_um")),
    ("optical paths of 1e5 waves", path_lengths, None),
    ("sun of 1e9 : 1 in a photograph", sun_in_the_frame, None),
    ("photograph with NaN", photograph_with(np.nan), "scene.exr"),
    ("photograph with an infinity", photograph_with(np.inf), "scene.exr"),
    ("photograph of one sample", lambda: even_photograph(24, 32, np.ones((1, 1))), None),
    ("photograph of 1 x 9", lambda: even_photograph(24, 32, np.ones((1, 9))), None),
    ("photograph of 7 x 1", lambda: even_photograph(24, 32, np.ones((7, 1))), None),
    ("sensor without a pixel", no_pixels, "rows"),
    ("sensor of one pixel", sizes(1, 1), None),
    ("sensor of 1 x 37", sizes(1, 37), None),
    ("sensor of 29 x 1", sizes(29, 1), None),
    ("sensor of 23 x 41", sizes(23, 41), None),
    ("bank with NaN", bank_with_nan, "finite"),
    ("bank with a PSF of no energy", bank_without_energy, "psf"),
    ("bank of odd size", bank_of_odd_size, "even number"),
    ("tolerance of 1e-9", tolerance_of("1e-9"), Engine("1e-5")),
    ("tolerance of 1e-6 sigma", tolerance_of("1e-6sigma"), Engine("sigma")),
    ("tolerance below float32's rounding", sigma_below_float32, Engine("float32")),
    ("tolerance below the alias", alias_floor, Engine("alias")),
)
