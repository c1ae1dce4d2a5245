"""Stiff and extreme cases: each with what is expected, what came out, and a verdict.

What is expected comes from a closed form or from the truth model, never from the engine. A case
that the product declines with a clear error is "refused", and says so; only what neither holds nor
is declined fails.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.special import ndtr
from scipy.stats import poisson

from gpusim.camera import Camera, load_camera
from gpusim.chain import Renderer
from gpusim.errors import UserError
from gpusim.gpu import Recording, default_device
from gpusim.lens.bank import Bank, default_pitch_um
from gpusim.lens.field_map import FieldMap
from gpusim.lens.generator import Generator
from gpusim.lens.prescription import load_prescription
from gpusim.lens.psf import intensity
from gpusim.lens.ready import load_ready
from gpusim.lens.system import build
from gpusim.lens.wavefront import pupils, sample_field
from gpusim.optics.fold import spectral_weights
from gpusim.plan import Accuracy
from gpusim.scene import make_scene
from gpusim.scene.chart import Chart, Rect
from gpusim.scene.exr import write_exr
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.noise import record_noise
from gpusim.sensor.sensor import ColourFilterArray, QuantumEfficiency, Sensor, load_sensor

HELD, REFUSED, FAILED = "held", "refused", "FAILED"
FLAT = np.full(WAVELENGTHS_NM.size, 1e-3)  # W m^-2 sr^-1 nm^-1
LEVEL = 1e-6  # of the tests of laws, at a fixed seed


@dataclass(frozen=True)
class Row:
    """One case: what it is, what was expected, what came out, and the verdict."""

    case: str
    expected: str
    got: str
    verdict: str


# A lens of which everything is known


def gaussian_bank(
    sigma_um: tuple[float, float] = (1.0, 1.0),
    *,
    size: int = 64,
    pitch_um: float = 0.5,
    wavelengths: int = 3,
    real_over_ideal: Callable[[np.ndarray], np.ndarray] = np.ones_like,
    rim_illumination: float = 1.0,
    circle_um: float = 150.0,
    fields: int = 12,
    efl_mm: float = 0.5,
) -> Bank:
    """Return a lens of Gaussian PSFs, as wide across and along the radius as `sigma_um` at the rim.

    On the axis both widths are the mean, from where they go with the square of the height, as does
    the illumination.
    """
    ideal = np.linspace(0.0, circle_um, fields)
    share = (ideal / circle_um) ** 2
    at = (np.arange(size) - size // 2) * pitch_um
    across, along = (np.mean(sigma_um) * (1 - share) + share * s for s in sigma_um)
    profile = [np.exp(-0.5 * (at / s[:, None]) ** 2) for s in (across, along)]
    psf = profile[0][:, :, None] * profile[1][:, None, :]
    psf /= psf.sum(axis=(1, 2), keepdims=True)
    lines = np.linspace(400.0, 700.0, wavelengths) if wavelengths > 1 else np.array([550.0])
    nothing = np.zeros((fields, wavelengths))
    light = 1 - (1 - rim_illumination) * share
    return Bank(
        wavelengths_nm=lines,
        reference_nm=float(lines[wavelengths // 2]),
        field_deg=np.degrees(np.arctan(ideal / (1e3 * efl_mm))),
        ideal_height_um=ideal,
        real_height_um=np.repeat((ideal * real_over_ideal(ideal))[:, None], wavelengths, axis=1),
        psf=np.repeat(psf[:, None], wavelengths, axis=1).astype(np.float32),
        relative_illumination=np.repeat(light[:, None], wavelengths, axis=1),
        projected_solid_angle_sr=np.full(wavelengths, 0.1),
        transmission=np.full(wavelengths, 0.6),
        outside_energy=nothing,
        folded_energy=nothing,
        fit_residual_waves=nothing,
        failed_rays=nothing,
        efl_mm=efl_mm,
        f_number=2.8,
        pitch_um=pitch_um,
        provenance={"title": "Gaussians", "source": "stress", "history": "made up"},
    )


def mono(rows: int = 48, cols: int = 64) -> Sensor:
    """Return the middle of a sensor of one channel without veiling glare."""
    whole = load_sensor("imx477")
    curves = whole.quantum_efficiency
    one = QuantumEfficiency(
        wavelengths_nm=curves.wavelengths_nm, channels={"W": curves.channels["G"]}
    )
    changes = {
        "cfa": ColourFilterArray(pattern=[["W"]]),
        "quantum_efficiency": one,
        "veiling_glare": 0.0,
        "full_well_e": 1e7,
    }
    return whole.roi(rows, cols).model_copy(update=changes)


def camera_of(bank: Bank, sensor: Sensor) -> Camera:
    """Return a camera with a given bank."""
    lens = SimpleNamespace(title="Gaussians", bank=lambda progress=None: bank)
    return Camera("stress", lens, sensor)


def edge_scene(position: float, dark: float = 0.05) -> Scene:
    """Return white left of a vertical edge, at a position in half-heights, and dark right of it."""
    white = Rect(position - 50.0, 0.0, 50.0, 60.0, 0.0, 1)
    chart = Chart(("dark", "white"), 0, (white,))
    return Scene("edge", np.stack([dark * FLAT, FLAT]), chart, "E", FLAT)


def rate_of(
    camera: Camera, scene: Scene, tolerance: float = 1e-3, tile_px: int | None = None
) -> np.ndarray:
    """Return the electrons/s (rows, cols) of a render."""
    renderer = Renderer(camera, scene, Accuracy(tolerance, 0))
    try:
        shot = renderer.capture(0.01, keep=("rate",), tile_px=tile_px)
        return shot.rate.astype(np.float64)
    finally:
        renderer.release()


def white_rate(bank: Bank, sensor: Sensor) -> float:
    """Return electrons/s of the white on the axis."""
    return float((spectral_weights(bank, sensor).sum(axis=1) @ FLAT)[0])


def edge_profile(
    position_um: float, sigma_um: float, sensor: Sensor, dark: float = 0.05
) -> np.ndarray:
    """Return what a row of pixels sees of the edge, over white: a normal law over the aperture."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    pitch = sensor.pixel_pitch_um
    width = pitch * np.sqrt(sensor.fill_factor)
    centre = (np.arange(sensor.cols) + 0.5 - sensor.cols / 2) * pitch
    distance = (position_um - centre[:, None] - nodes * width / 2) / sigma_um
    return dark + (1 - dark) * (ndtr(distance) @ weights) / 2


def compared(found: np.ndarray, expected: np.ndarray, bound: float, what: str) -> tuple:
    """Return expected, got and whether the largest difference is within a bound of white."""
    worst = float(np.abs(found - expected).max()) if np.isfinite(found).all() else np.inf
    return f"{what}, to {bound:.0e} of white", f"{worst:.1e} of white off", worst <= bound


def edge_case(
    bank: Bank,
    sigma_um: float,
    rows: int = 48,
    cols: int = 64,
    bound: float = 3e-3,
    tolerance: float = 1e-3,
) -> tuple:
    """Compare the middle row of an edge with its closed form."""
    sensor = mono(rows, cols)
    position = 0.137 * cols / rows
    half_um = rows * sensor.pixel_pitch_um / 2
    rate = rate_of(camera_of(bank, sensor), edge_scene(position), tolerance)
    middle = rate[rows // 2] / white_rate(bank, sensor)
    expected = edge_profile(position * half_um, sigma_um, sensor)
    return compared(middle, expected, bound, "normal law over the aperture")


def certified_case(bank: Bank, sensor: Sensor, scene: Scene, tolerance: float) -> tuple:
    """Hold a render against the truth model."""
    renderer = Renderer(camera_of(bank, sensor), scene, Accuracy(tolerance, 16))
    try:
        found = renderer.capture(0.01).certificate
    finally:
        renderer.release()
    got = f"RMS {found.rms_relative:.1e}, worst {found.worst_relative:.1e}"
    return f"truth model, RMS to {tolerance:g}", got, found.met


# The cases: each returns what is expected, what came out, and whether that is right


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
        focal_um = 150.0 / np.tan(np.radians(rim_deg))
        bank = gaussian_bank(
            real_over_ideal=lambda r: np.where(
                r > 0, focal_um * np.arctan(r / focal_um) / np.maximum(r, 1e-9), 1.0
            ),
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


def outside_the_circle() -> tuple:
    """Take a sensor whose corners lie outside the image circle."""
    bank, sensor = gaussian_bank(circle_um=45.0), mono(48, 64)
    camera_of(bank, sensor).bank()
    return "black and flagged", "accepted without a word", False


def beyond_the_circle_is_black() -> tuple:
    """Ask the engine itself, past that check: black beyond the circle, white within."""
    bank, sensor = gaussian_bank(circle_um=45.0), mono(48, 64)
    camera = SimpleNamespace(sensor=sensor, bank=lambda progress=None: bank)
    scene = Scene("white", FLAT[None], Chart(("white",), 0, ()), "E", FLAT)
    rate = rate_of(camera, scene) / white_rate(bank, sensor)
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


def noise_of(mean: float, shape: tuple[int, int]) -> np.ndarray:
    """Return electrons of an even frame, without read noise and offsets."""
    device = default_device()
    sensor = mono(8, 8).model_copy(update={"temporal_dark_noise_e": 0.0, "dsnu_e": 0.0})
    even = device.resident("mean", np.full(shape, mean, np.float32))
    rec = Recording(device)
    label = rec.download(record_noise(rec, even, sensor, seed=7))
    try:
        return rec.run()[label].astype(np.float64)
    finally:
        even.destroy()


def poisson_at_a_millionth() -> tuple:
    """Draw Poisson counts of a mean of 1e-6 over four million pixels."""
    total = noise_of(1e-6, (2048, 2048)).sum()
    low, high = poisson.interval(1 - LEVEL, 2048**2 * 1e-6)
    return f"{low:g} to {high:g} counts in all", f"{total:g}", low <= total <= high


def poisson_at_ten_million() -> tuple:
    """Draw Poisson counts of a mean of 9e6, close to where f32 has gaps."""
    counts = noise_of(9e6, (512, 512))
    n = counts.size
    mean = (counts.mean() - 9e6) / np.sqrt(9e6 / n)
    spread = (counts.var() / 9e6 - 1) / np.sqrt(2 / n)
    odd = (np.mean(counts % 2) - 0.5) / np.sqrt(0.25 / n)
    got = f"mean {mean:+.1f}, variance {spread:+.1f}, odd counts {odd:+.1f} sigma off"
    return (
        "mean, variance and odd counts within 5 sigma",
        got,
        max(map(abs, (mean, spread, odd))) < 5,
    )


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
            return f"refused: {words}", _short(error), REFUSED if words in said else False
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
    """Take a PSF of 0.2 um at a tolerance of 1e-4: the finest sim grid folds more back."""
    bank = gaussian_bank((0.2, 0.2), pitch_um=0.1)
    rate_of(camera_of(bank, mono(24, 24)), edge_scene(0.1), 1e-4)
    return "refused: alias", "accepted", False


# Case, what is done, and words that a refusal must have, should it be one: None where it must hold.
CASES: tuple[tuple[str, Callable[[], tuple], str | None], ...] = (
    ("PSF smaller than a sim pixel", psf_below_a_sample, None),
    ("PSF wider than a tile and the image", psf_wider_than_a_tile, None),
    ("bank with one field", one_field, "fields"),
    ("bank with one wavelength", one_wavelength, None),
    ("lens alike over the field, one cell", one_node, None),
    ("vignetted, one-sided pupil", one_sided_pupil, None),
    ("distortion near fold-over", near_fold, "smooth"),
    ("distortion beyond fold-over", beyond_fold, "rising"),
    ("fisheye, 55 degrees", fisheye(55.0), None),
    ("fisheye, 70 degrees", fisheye(70.0), "smooth"),
    ("sensor outside the image circle", outside_the_circle, "image circle"),
    ("black beyond the image circle", beyond_the_circle_is_black, None),
    ("principal point off centre", principal_point_off_centre, "principal_point_um"),
    ("optical paths of 1e5 waves", path_lengths, None),
    ("Poisson at a mean of 1e-6", poisson_at_a_millionth, None),
    ("Poisson at a mean of 9e6", poisson_at_ten_million, None),
    ("sun of 1e9 : 1 in a photograph", sun_in_the_frame, None),
    ("photograph with NaN", photograph_with(np.nan), "scene.exr"),
    ("photograph with an infinity", photograph_with(np.inf), "scene.exr"),
    ("photograph with a negative", photograph_with(-1.0), "scene.exr"),
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
    ("tolerance of 1e-9", tolerance_of("1e-9"), "1e-5"),
    ("tolerance of 1e-6 sigma", tolerance_of("1e-6sigma"), "sigma"),
    ("tolerance below float32's rounding", sigma_below_float32, "float32"),
    ("tolerance below the alias", alias_floor, "alias"),
)


def run(
    names: tuple[str, ...] = (), progress: Callable[[str, int, int], None] | None = None
) -> list[Row]:
    """Run the cases, or those whose names are given; a defect in one does not stop the others."""
    chosen = [case for case in CASES if not names or case[0] in names]
    rows = []
    for done, (name, case, refusal) in enumerate(chosen):
        if progress is not None:
            progress("stress", done, len(chosen))
        rows.append(judged(name, case, refusal))
    if progress is not None:
        progress("stress", len(chosen), len(chosen))
    return rows


def judged(name: str, case: Callable[[], tuple], refusal: str | None) -> Row:
    """Run one case and judge it."""
    wanted = "it holds" if refusal is None else f"refused, naming {refusal}"
    try:
        expected, got, right = case()
    except UserError as error:
        clear = refusal is not None and refusal in error.screen()
        return Row(name, wanted, _short(error), REFUSED if clear else FAILED)
    except Exception as error:  # a crash is what this table is to show
        return Row(name, wanted, f"{type(error).__name__}: {error}", FAILED)
    if right == REFUSED:
        return Row(name, expected, got, REFUSED)
    return Row(name, expected, got, HELD if right else FAILED)


def _short(error: UserError) -> str:
    """Return an error in one line."""
    value = "" if error.value is None else f" ({error.field}: {error.value})"
    return f"{error.problem}{value}"
