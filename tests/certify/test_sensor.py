"""The sensor's part of the certificate: sound chains leave float32, planted defects turn it red.

Bound of the sound chains, relative to the mean electrons. All that a pixel has is a sum of terms
that are not negative, so roundings of the terms are roundings of the sum. In units of 2^-24:
cross-talk K^2 + 1 (tests/sensor/test_crosstalk.py), exposure, response and dark current 18
(test_exposure.py), smear 4, a linear transfer 30 each (test_cti.py); beside these the deviates,
5e-6 of PRNU and 4e-6 of the dark current where DCNU draws it (test_exposure.py). Traps take part in
exp2 and pow, each good to 1e-5 of what they take (test_traps.py).
"""

from __future__ import annotations

import shutil
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from optics.made import StubCamera, bank, monochrome, scene, sensor, shapes
from sampling import one_in
from scipy.stats import binom

from gpusim.certify import Certificate, MeanSignal, Measure, Placed, sensor_share
from gpusim.certify import sensor as module
from gpusim.gpu.wgsl import shaders_root
from gpusim.plan import Accuracy
from gpusim.render import Renderer, reading, renderer
from gpusim.render import certificate as judging
from gpusim.sensor import cti
from gpusim.sensor.adc_model import DualGain
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.crosstalk_model import Crosstalk, Kernels
from gpusim.sensor.cti_model import Cti, Species
from gpusim.sensor.frame import Border, Overscan
from gpusim.sensor.noise_model import Defects, LineNoise, Masks
from gpusim.sensor.sensor import Sensor
from gpusim.sensor.smear_model import Smear

ULP = 2.0**-24
LENS = bank(coma_um=0.0, falloff=0.1)
ROWS, COLS = 40, 56
EXPOSURE_S, WARM_C = 0.01, 40.0
RED_AT = Accuracy(tolerance=1e-2, probes=16)

ASKEW = [[0.0, 0.02, 0.01], [0.03, 0.7, 0.2], [0.0, 0.02, 0.02]]
SPREAD = Crosstalk(optical=Kernels({"*": ASKEW}), electrical=Kernels({"*": ASKEW}))
BAYER_5 = Crosstalk(
    optical=Kernels({"R>G": [[0, 0, 0, 0, 0.1], [0] * 5, [0] * 5], "G>*": [[0.02, 0, 0.03]]})
)
BLACK = Border(top=4, bottom=2, left=6, right=3)
UNLIKE = {
    "prnu_percent": 5.0,
    "dcnu_percent": 30.0,
    "dark_current_e_per_s": 500.0,
    "lines": LineNoise(prnu_row_percent=2.0, prnu_column_percent=3.0),
    "defects": Defects(hot_fraction=0.1, dead_fraction=0.1, hot_e_per_s=1e4),
}
TRAPS = Cti(
    traps=(Species(density=4.0, release_transfers=3.0), Species(density=2.0, release_transfers=20)),
    groups=3,
)
LINEAR = Cti(inefficiency=1e-2)
INTERLINE = Smear(kind="interline", row_s=5e-4, leak=0.5)
STORED = Smear(kind="frame_transfer", row_s=1e-4)
ONE_WAY = Smear(kind="frame_transfer", row_s=1e-4, cleared_by_shift=False)
AFTER = Overscan(rows=5, cols=7)
X_TRANS = ColourFilterArray(
    pattern=[list(row) for row in "GBGGRG RGRBGB GBGGRG GRGGBG BGBRGR GRGGBG".split()]
)
MERGED = DualGain(
    system_gain_dn_per_e=0.1, temporal_dark_noise_e=5.0, black_level_dn=64, switch_dn=3000
)

CMOS = {
    "plain": {},
    "cross-talk, response, defects": {"crosstalk": SPREAD, **UNLIKE},
    "kernels by channel": {"crosstalk": BAYER_5, "prnu_percent": 5.0},
    "border": {"crosstalk": SPREAD, "optical_black": BLACK, **UNLIKE},
    "X-Trans": {"cfa": X_TRANS, "crosstalk": SPREAD, **UNLIKE},
    "two gains": {"dual_gain": MERGED, "analogue_gains": (), "crosstalk": SPREAD},
}
CCDS = {
    "interline, linear": {"smear": INTERLINE, "parallel_cti": LINEAR, "serial_cti": LINEAR},
    "stored, traps": {"smear": STORED, "parallel_cti": TRAPS, "serial_cti": TRAPS, **UNLIKE},
    "one way, cross-talk": {"smear": ONE_WAY, "crosstalk": SPREAD, "overscan": AFTER, **UNLIKE},
    "blooming": {"bloom": True, "full_well_e": 180.0, "parallel_cti": LINEAR, "smear": STORED},
    "full well": {"full_well_e": 180.0, "serial_cti": LINEAR, **UNLIKE},
    "border": {"optical_black": BLACK, "smear": STORED, "parallel_cti": TRAPS, "overscan": AFTER},
}
TILES = [None, (0, 0, 7, 5), (21, 13, 20, 9), (COLS - 1, ROWS - 1, 1, 1)]


def certificate(one: Sensor, accuracy: Accuracy = RED_AT, **more) -> Certificate:
    renderer = Renderer(
        StubCamera(LENS, one),
        scene(shapes()),
        accuracy,
        method="fft",
        noise=more.pop("noise", True),
    )
    try:
        keep = ("electrons",)
        return renderer.capture(EXPOSURE_S, temperature_c=WARM_C, keep=keep, **more).certificate
    finally:
        renderer.release()


@lru_cache
def light(cfa: str) -> np.ndarray:
    pattern = ColourFilterArray(pattern=[list(row) for row in cfa.split()])
    plain = monochrome(ROWS, COLS) if cfa == "W" else made(cfa=pattern)
    one = Renderer(StubCamera(LENS, plain), scene(shapes()), Accuracy(1e-2, 0), method="fft")
    try:
        return one.capture(EXPOSURE_S, keep=("rate",)).rate.astype(float)
    finally:
        one.release()


@pytest.fixture(autouse=True)
def no_optics(monkeypatch):
    """Let the engine be without error: its truth is the light of a plain sensor, as rendered.

    What is left is the sensor's part; and the exact model is slow.
    """

    class Rendered:
        def __init__(self, lens, one, scene, placed) -> None:
            self.bank, self.sensor, self.scene, self.placed = lens, one, scene, placed
            self.light = light(" ".join(map("".join, one.cfa.pattern)))

        def rates(self, pixels, progress=None) -> np.ndarray:
            return self.light[tuple(pixels.T)]

    light("BG GR")  # by shaders without planted defects
    monkeypatch.setattr(judging, "ExactModel", Rendered)


def made(**fields) -> Sensor:
    return sensor(ROWS, COLS, first_row=6, first_col=12, **fields)


def bound(one: Sensor) -> float:
    has_traps = sum(c is not None and bool(c.traps) for c in (one.parallel_cti, one.serial_cti))
    linear = sum(c is not None and not c.traps for c in (one.parallel_cti, one.serial_cti))
    side = 0 if one.crosstalk is None else max(one.crosstalk.optical.side, 3)
    roundings = side**2 + 1 + 18 + 4 * (one.smear is not None) + 30 * linear
    deviates = 4e-6 * (one.dcnu_percent > 0) + 5e-6 * (one.prnu_percent / 100 + 0.05)
    return roundings * ULP + deviates + 2e-5 * has_traps


def check(found: Certificate, one: Sensor) -> None:
    assert 0 < found.sensor_rms <= found.sensor_worst <= bound(one)
    assert found.engine_worst == 0 and found.total_rms == pytest.approx(found.sensor_rms)
    assert found.met


# Sound chains


@pytest.mark.parametrize("tile", TILES, ids=["whole", "corner", "tile", "pixel"])
@pytest.mark.parametrize("name", one_in(2, CMOS))
def test_a_sound_sensor_leaves_roundings(name: str, tile: tuple | None):
    one = made(**CMOS[name])
    check(certificate(one, tile=tile), one)


@pytest.mark.parametrize("tile", TILES[:3], ids=["whole", "corner", "tile"])
@pytest.mark.parametrize("name", CCDS)
def test_a_sound_ccd_leaves_roundings(name: str, tile: tuple | None):
    one = made(**CCDS[name])
    check(certificate(one, tile=tile), one)


@pytest.mark.parametrize("fields", [CMOS["border"], CCDS["blooming"], CCDS["full well"]])
def test_so_it_does_without_noise(fields: dict):
    one = made(**fields)
    check(certificate(one, noise=False), one)


def test_a_sensor_without_filters_and_with_a_mask(tmp_path: Path):
    gain = np.random.default_rng(3).uniform(0.5, 1.5, (ROWS + 4, COLS + 6)).astype(np.float32)
    np.save(tmp_path / "gain.npy", gain)
    area = (4, 10, ROWS + 4, COLS + 6)
    mask = Masks(gain="gain.npy").model_copy(update={"area": area}).placed(tmp_path, area)
    for more in ({}, {"optical_black": BLACK}):
        one = monochrome(ROWS, COLS, first_row=6, first_col=12, masks=mask, **more)
        check(certificate(one), one)


def test_small_tiles_and_files_change_nothing(tmp_path: Path):
    for number, fields in enumerate((CMOS["border"], CCDS["one way, cross-talk"])):
        one, folder = made(**fields), tmp_path / str(number)
        folder.mkdir()
        whole, cut = certificate(one), certificate(one, tile_px=18, folder=folder)
        assert (cut.sensor_rms, cut.sensor_worst) == (whole.sensor_rms, whole.sensor_worst)


def test_the_note_says_what_was_covered():
    *_, note = certificate(made(**CCDS["border"])).notes
    for word in ("border", "smear", "parallel transfer", "at 16 probes"):
        assert word in note
    assert "serial" not in note and "cross-talk" not in note and "\n" not in note


def test_without_a_certificate_nothing_of_it_is_done(monkeypatch):
    asked = []
    for kind in (reading.CmosReading, reading.CcdReading):
        right = kind.__init__

        def spy(self, renderer, rect, names, folder, shot, right=right):
            asked.append(set(names))
            right(self, renderer, rect, names, folder, shot)

        monkeypatch.setattr(kind, "__init__", spy)
    for fields in (CMOS["border"], CCDS["border"]):
        assert certificate(made(**fields), Accuracy(1e-2, 0)) is None
    assert asked and not any({"mean", "rate"} & names for names in asked)


# Planted defects


def planted(monkeypatch, folder: Path, shader: str, line: str, wrong: str) -> None:
    root = folder / "shaders"
    shutil.copytree(shaders_root(), root)
    file = root / f"sensor/{shader}.wgsl"
    assert file.read_text().count(line) == 1
    file.write_text(file.read_text().replace(line, wrong))
    monkeypatch.setenv("GPUSIM_SHADERS_DIR", str(root))


FINE = Accuracy(tolerance=1e-3, probes=16)
WRONG = {
    "a factor": ("exposure", "params.exposure_s * response", "1.02 * params.exposure_s * response"),
    "the pixel below": ("exposure", "params.row0 + id.y;", "params.row0 + id.y + 1u;"),
    "dark current": (
        "exposure",
        "var dark = vec4f(params.dark_e)",
        "var dark = vec4f(0.5 * params.dark_e)",
    ),
    "hot pixels": ("defects", "+ add[id.x]", "+ 0.5 * add[id.x]"),
    "a tap": ("crosstalk", "sum.left + s0 * x.a;", "sum.left + 0.8 * s0 * x.a;"),
    "nothing": ("exposure", "params.exposure_s * response", "params.exposure_s * response"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_shader_turns_it_red(monkeypatch, tmp_path: Path, name: str):
    planted(monkeypatch, tmp_path, *WRONG[name])
    one = made(**CMOS["cross-talk, response, defects"])
    found = certificate(one, Accuracy(1e-2, 64))
    if name == "nothing":  # a control: the copy itself changes nothing
        check(found, one)
        return
    assert not found.met
    assert found.sensor_rms > 10 * bound(one)


WRONG_CCD = {
    "smear, 1 %": ("smear", "+ weight * passed", "+ 1.01 * weight * passed", INTERLINE, LINEAR),
    "one row fewer": (
        "smear",
        "let total = sums[pieces",
        "let total = 0.9 * sums[pieces",
        STORED,
        LINEAR,
    ),
    "linear, 5 %": ("cti", "sum += weights", "sum += 0.95 * weights", STORED, LINEAR),
    "traps, 10 %": (
        "traps",
        "select(1.0, taken / wanted, taken < wanted)",
        "0.9 * select(1.0, taken / wanted, taken < wanted)",
        STORED,
        TRAPS,
    ),
}


@pytest.mark.parametrize("direction", ["parallel_cti", "serial_cti"])
@pytest.mark.parametrize("name", WRONG_CCD)
def test_a_wrong_shader_of_a_ccd_turns_it_red(monkeypatch, tmp_path: Path, name: str, direction):
    *change, smear, model = WRONG_CCD[name]
    planted(monkeypatch, tmp_path, *change)
    found = certificate(made(smear=smear, **{direction: model}), FINE)
    assert not found.met and found.sensor_rms > 1e-3


def test_blooming_to_one_side_turns_it_red(monkeypatch, tmp_path: Path):
    planted(monkeypatch, tmp_path, "bloom", "floor(0.5 * excess)", "floor(0.3 * excess)")
    found = certificate(made(bloom=True, full_well_e=180.0), Accuracy(1e-2, 64))
    assert not found.met and found.sensor_worst > 0.05


def test_light_on_the_border_turns_it_red(monkeypatch, tmp_path: Path):
    planted(monkeypatch, tmp_path, "border", "var value = 0.0;", "var value = 1e4;")
    one = made(crosstalk=SPREAD, optical_black=BLACK)
    found = certificate(one, tile=(0, 0, 4, 4))
    assert not found.met and found.sensor_rms > 1e-2


def test_a_kernel_turned_about_turns_it_red(monkeypatch):
    right = Kernels.shares
    monkeypatch.setattr(Kernels, "shares", lambda *given: right(*given).swapaxes(2, 3))
    found = certificate(made(crosstalk=SPREAD))
    assert not found.met and found.sensor_rms > 1e-2


def test_a_leak_one_percent_off_turns_it_red(monkeypatch):
    right = Smear.weight_s.fget
    monkeypatch.setattr(Smear, "weight_s", property(lambda smear: 1.01 * right(smear)))
    found = certificate(made(smear=INTERLINE), FINE)
    assert not found.met and found.sensor_rms > 1e-3


@pytest.mark.parametrize("direction", ["parallel_cti", "serial_cti"])
def test_an_inefficiency_five_percent_off_turns_it_red(monkeypatch, direction: str):
    right = cti.shares
    monkeypatch.setattr(cti, "shares", lambda count, before, e: right(count, before, 1.05 * e))
    found = certificate(made(**{direction: LINEAR}), FINE)
    assert not found.met and found.sensor_rms > 1e-3


def test_a_stage_that_the_plan_forgets_turns_it_red(monkeypatch):
    """What the sensor has, its file says: the plan is judged as well."""
    right = renderer.Plan.runs
    monkeypatch.setattr(
        renderer.Plan, "runs", lambda plan, name: name != "prnu" and right(plan, name)
    )
    found = certificate(made(prnu_percent=5.0))
    assert not found.met and found.sensor_rms == pytest.approx(0.05, rel=0.5)


# How it counts


PIXELS = np.array([[3, 4], [5, 6], [7, 8], [9, 2]])
FLAT = (0, 0, 12, 12)


def share_of(factor: float, accuracy: Accuracy, signal_e: float = 1000.0, **fields):
    one = sensor(12, 12, prnu_percent=0.0, dark_current_e_per_s=0.0, **fields)
    rate = np.full((12, 12), signal_e)
    mean = Placed(factor * rate, FLAT)
    found = MeanSignal(Placed(rate, FLAT), mean, mean if one.is_ccd else None)
    return sensor_share(Measure(one, 1.0, accuracy), found, PIXELS, temperature_c=25.0, noise=True)[
        0
    ]


def test_an_error_is_relative_to_the_electrons_or_to_their_noise():
    relative = share_of(1.003, Accuracy(1e-2, 4))
    assert relative.rms == pytest.approx(0.003) and relative.probes == 4
    sigma = share_of(1.003, Accuracy(1e-2, 4, "sigma"), temporal_dark_noise_e=5.0)
    assert sigma.worst == pytest.approx(3 / np.sqrt(1025))


def test_beyond_the_full_well_no_sigmas_are_counted():
    sigma = Accuracy(1e-2, 4, "sigma")
    assert share_of(1.003, sigma, full_well_e=900.0).worst == 0
    assert share_of(1.003, sigma, full_well_e=1001.0, temporal_dark_noise_e=0.0).worst == (
        pytest.approx(1 / np.sqrt(1000))
    )
    # 800 electrons are shown of 900; and so much noise has the full well.
    assert share_of(0.8, sigma, full_well_e=900.0, temporal_dark_noise_e=0.0).worst == (
        pytest.approx(100 / 30)
    )
    assert share_of(1.003, Accuracy(1e-2, 4), full_well_e=900.0).worst == pytest.approx(0.003)


def test_signal_where_there_is_none_is_an_error_of_all():
    one = sensor(12, 12, prnu_percent=0.0, dark_current_e_per_s=0.0, temporal_dark_noise_e=0.0)
    frame = {"temperature_c": 25.0, "noise": True}
    for made_e, expected in ((0.0, 0.0), (1e-3, 1.0)):
        dark = MeanSignal(Placed(np.zeros((12, 12)), FLAT), Placed(np.full((12, 12), made_e), FLAT))
        share, _ = sensor_share(Measure(one, 1.0, Accuracy(1e-2, 4)), dark, PIXELS, **frame)
        assert share.rms == share.worst == expected
        share, _ = sensor_share(
            Measure(one, 1.0, Accuracy(1e-2, 4, "sigma")), dark, PIXELS, **frame
        )
        assert share.worst == 0  # as the engine's part: without noise there are no sigmas


def test_errors_of_columns_and_rows_are_added():
    """Columns that give 0.4 % too much, and rows that lose 0.1 % of what they got."""
    one = sensor(12, 12, prnu_percent=0.0, dark_current_e_per_s=0.0, overscan=AFTER)
    rate = np.full((12, 12), 1000.0)
    charge, mean = Placed(1.004 * rate, FLAT), Placed(1.003 * rate, FLAT)
    found = MeanSignal(Placed(rate, FLAT), mean, charge)
    by = Measure(one, 1.0, Accuracy(1e-2, 4))
    share, _ = sensor_share(by, found, PIXELS, temperature_c=25.0, noise=True)
    assert share.worst == pytest.approx(0.005 / 1.004)


@pytest.mark.parametrize("inefficiency", [1e-6, 1e-4, 1e-2, 0.3])
@pytest.mark.parametrize("transfers", [1, 50, 700, 9000])
def test_the_history_holds_what_matters(inefficiency: float, transfers: int):
    """The binomial law of what comes from farther ahead, against Bernstein's bound."""
    reach = module._history(inefficiency, transfers)
    assert binom.sf(reach, transfers, inefficiency) < 1.1e-10  # exp(-23) is 1.03e-10
    assert reach < 3 * (transfers * inefficiency + 26)  # and not all of a long line
