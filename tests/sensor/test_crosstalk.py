"""Cross-talk: against float64 for patterns, kernels and rectangles of all kinds; its noise.

Tolerance of the stage: a sum of n = K^2 products in f32, n 2^-24 of the sum of their sizes, and the
rounding of each share, 2^-24 of the same; all shares and signals are positive, and the shares of
these kernels sum to 1 at most, so (K^2 + 1) 2^-24 of the largest signal.
"""

import numpy as np
import pytest
from changes import sensor_file
from harness import assert_close
from optics.made import StubCamera, bank, monochrome, scene, sensor, shapes
from sampling import one_in
from scipy.stats import norm

from gpusim.errors import UserError
from gpusim.gpu import Device, Kernel, Recording
from gpusim.plan import Accuracy
from gpusim.plan.tiles import aligned
from gpusim.reference.crosstalk import autocorrelation, crosstalk, crosstalk_at
from gpusim.render import Renderer
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.crosstalk import ROWS, grown, reach, record_crosstalk
from gpusim.sensor.crosstalk_model import Crosstalk, Kernels
from gpusim.sensor.load import load_sensor
from gpusim.sensor.readout import Shot, SiteLight, record_readout, rects_of
from gpusim.sensor.sensor import Sensor

F32 = np.float32
ULP = 2.0**-24
BAYER = ("RG", "GB")
XTRANS = ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG")
PATTERNS = (("W",), BAYER, ("RGB",), ("RG", "GB", "WG"), ("RRGG", "RRGG", "GGBB", "GGBB"), XTRANS)
CAPACITANCE = [[0.0, 0.02, 0.0], [0.03, 0.88, 0.03], [0.0, 0.02, 0.0]]
LEVEL = 1e-3  # of the statistical test; the seed is fixed
EXPOSURE = 0.01


def of_pattern(pattern: tuple[str, ...], rows: int, cols: int) -> Sensor:
    return load_sensor("imx477").unchecked(
        rows=rows, cols=cols, cfa=ColourFilterArray(pattern=[list(row) for row in pattern])
    )


def kernels_of(pattern: tuple[str, ...], side: int, seed: int = 7) -> Kernels:
    """Return unlike kernels for all pairs of channels, without any symmetry; they lose light."""
    rng = np.random.default_rng(seed)
    names = sorted(set("".join(pattern)))
    found = {}
    for giver in names:
        for taker in names:
            kernel = rng.uniform(0, 1 / side**2, (side, side))
            kernel[side // 2, side // 2] *= giver == taker
            found[f"{giver}>{taker}"] = kernel.tolist()
    return Kernels(found)


@pytest.mark.parametrize("first", [(0, 0), (-3, -4)])
@pytest.mark.parametrize("side", [1, 3, 7])
@pytest.mark.parametrize("pattern", PATTERNS, ids="/".join)
def test_the_reference_of_pixels_alone_is_that_of_the_whole(pattern, side: int, first: tuple):
    """What each takes, and what each gives: float64 both; with a border before the pattern."""
    camera, kernels = of_pattern(pattern, 13, 17), kernels_of(pattern, side)
    signal = light(13, 17)
    row, col = np.arange(13)[:, None] + first[0], np.arange(17) + first[1]
    names, period = np.array(camera.cfa.pattern), camera.period
    expected = crosstalk(signal, names[row % period[0], col % period[1]], kernels.between, period)
    found = crosstalk_at(
        row,
        col,
        lambda row, col: signal[row - first[0], col - first[1]].astype(float),
        pattern=camera.cfa.pattern,
        between=kernels.between,
        frame=(*first, 13, 17),
    )
    assert_close(found, expected, rtol=1e-12)


def light(rows: int, cols: int) -> np.ndarray:
    return np.random.default_rng(rows + cols).uniform(0, 1e4, (rows, cols)).astype(F32)


def on_device(device: Device, signal: np.ndarray, kernels: Kernels, camera: Sensor, rect, given):
    """Return the cross-talk of a rectangle from that which is given; NaN is around the signal."""
    row, col, rows, cols = given
    rec = Recording(device)
    source = rec.buffer("signal", (rows, cols), F32)
    rec.upload(source, np.ascontiguousarray(signal[row : row + rows, col : col + cols]))
    label = rec.download(record_crosstalk(rec, source, kernels, camera, given=given, wanted=rect))
    return rec.run()[label]


def expected_of(signal: np.ndarray, kernels: Kernels, camera: Sensor) -> np.ndarray:
    pattern = np.array(camera.cfa.pattern)
    row, col = (np.arange(n) % step for n, step in zip(signal.shape, camera.period, strict=True))
    return crosstalk(signal, pattern[row[:, None], col], kernels.between, camera.period)


@pytest.mark.parametrize("side", one_in(2, [3, 1, 5, 7]))
@pytest.mark.parametrize("pattern", PATTERNS, ids="/".join)
def test_each_pixel_takes_its_shares(device: Device, pattern: tuple[str, ...], side: int):
    rows, cols = ROWS + 3, 61
    camera, kernels = of_pattern(pattern, rows, cols), kernels_of(pattern, side)
    signal, whole = light(rows, cols), (0, 0, rows, cols)
    found = on_device(device, signal, kernels, camera, whole, whole)
    atol = (max(side, 3) ** 2 + 1) * ULP * signal.max()
    assert_close(found, expected_of(signal, kernels, camera), atol=atol)
    # The control: turned kernels, and those of the wrong channels, are others.
    turned = Kernels({pair: np.array(k)[::-1, ::-1].tolist() for pair, k in kernels.root.items()})
    if side > 1:
        assert np.abs(found - expected_of(signal, turned, camera)).max() > 1e3 * atol
    if len(kernels.root) > 1:
        swapped = Kernels({">".join(pair.split(">")[::-1]): k for pair, k in kernels.root.items()})
        if side > 1:
            assert np.abs(found - expected_of(signal, swapped, camera)).max() > 1e3 * atol


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 8), (ROWS, 7), (ROWS + 1, 17)])
@pytest.mark.parametrize("pattern", [BAYER, XTRANS], ids="/".join)
def test_tiles_are_parts_of_the_whole_bit_for_bit(device: Device, pattern, shape):
    rows, cols, side = 41, 67, 5
    camera, kernels = of_pattern(pattern, rows, cols), kernels_of(pattern, side)
    signal, whole = light(rows, cols), (0, 0, rows, cols)
    full = on_device(device, signal, kernels, camera, whole, whole)
    corners = [(0, 0), (3, 5), (rows - shape[0], cols - shape[1]), (20, 33)]
    for row, col in corners:
        rect = (row, col, *shape)
        given = grown(rect, reach(kernels, camera.period), whole)
        found = on_device(device, signal, kernels, camera, rect, given)
        assert_close(found, full[row : row + shape[0], col : col + shape[1]], atol=0)


def test_a_rectangle_without_its_neighbours_is_refused(device: Device):
    camera, kernels = of_pattern(BAYER, 40, 40), kernels_of(BAYER, 3)
    rect = (10, 10, 8, 8)
    with pytest.raises(ValueError, match="does not give"):
        on_device(device, light(40, 40), kernels, camera, rect, rect)
    with pytest.raises(ValueError, match="does not give"):
        on_device(device, light(40, 40), kernels, camera, rect, (9, 9, 10, 9))


@pytest.mark.parametrize("side", [3, 7])
def test_a_flat_field_stays_flat_and_keeps_its_light(device: Device, side: int):
    """Every channel has a level of its own: at the edge too each takes from the right ones."""
    camera = of_pattern(BAYER, 40, 50)
    kernel = np.full((side, side), 0.3 / (side**2 - 1))
    kernel[side // 2, side // 2] = 0.7
    kernels, whole = Kernels({"*": kernel.tolist()}), (0, 0, 40, 50)
    level = np.tile(np.array([[100.0, 200.0], [200.0, 400.0]], F32), (20, 25))
    found = on_device(device, level, kernels, camera, whole, whole).reshape(20, 2, 25, 2)
    for row, col in np.ndindex(2, 2):
        site = found[:, row, :, col]
        assert_close(site, np.full(site.shape, site[5, 5], float), atol=0)
    sums = found.astype(float).mean(axis=(0, 2)).sum()
    assert sums == pytest.approx(900.0, rel=(side**2 + 1) * ULP)


def test_a_point_gives_what_the_kernel_says(device: Device):
    """Asymmetric, so that it tells right from left: the kernel stands around the giver."""
    kernels = Kernels({"*": [[0.0, 0.0, 0.0], [0.0, 0.9, 0.0625], [0.0, 0.03125, 0.0]]})
    camera, whole = of_pattern(("W",), 9, 9), (0, 0, 9, 9)
    point = np.zeros((9, 9), F32)
    point[4, 4] = 16
    found = on_device(device, point, kernels, camera, whole, whole)
    assert found[4, 4] == F32(0.9) * 16
    assert (found[4, 5], found[5, 4], found[4, 3], found[3, 4]) == (1.0, 0.5, 0.0, 0.0)


def test_the_most_definite_key_counts():
    one = {name: [[value]] for name, value in (("*", 0.1), ("R>*", 0.2), ("*>R", 0.3))}
    kernels = Kernels(one | {"R>R": [[0.4]]})
    pairs = (("R", "R"), ("R", "G"), ("G", "R"), ("G", "B"))
    assert [kernels.between(*pair)[0, 0] for pair in pairs] == [0.4, 0.2, 0.3, 0.1]
    alone = Kernels({"R>G": [[0.1, 0, 0.1]]})
    assert alone.between("B", "B")[1, 1] == 1 and alone.between("B", "G").sum() == 0


# What it does to the noise, in the whole chain

FLAT = scene(spectra=np.full((1, 61), 1e-3))
ELECTRICAL = Crosstalk(electrical=Kernels({"*": CAPACITANCE}))
QUIET = {"prnu_percent": 0.0, "dsnu_e": 0.0, "temporal_dark_noise_e": 0.0}


def flat_frame(device: Device, spread: Crosstalk | None) -> np.ndarray:
    camera = monochrome(256, 512, crosstalk=spread, dark_current_e_per_s=1e5, **QUIET)
    rec = Recording(device)
    runs = {
        "noise",
        "mosaic",
        "electrical crosstalk" if spread and spread.electrical else "crosstalk",
    }
    runs -= set() if spread else {"crosstalk"}
    planes, glare = rec.buffer("planes", (1, 256, 512), F32), rec.buffer("glare", 1, F32)
    rec.upload(planes, np.full((1, 256, 512), 1e5, F32))
    rec.clear(glare)
    frame = (0, 0, 256, 512)
    made = record_readout(
        rec,
        SiteLight(planes, glare, frame),
        camera,
        frame,
        shot=Shot(0.01, 3, 0),
        runs=runs.__contains__,
    )
    label = rec.download(made["electrons"])
    return rec.run()[label].astype(float)


def correlations(field: np.ndarray) -> np.ndarray:
    """Return the autocorrelation at distances 0..2 rows and -2..2 columns, of the inner pixels."""
    off = field - field.mean()
    rows, cols = field.shape
    middle = off[3:-3, 3:-3]
    return np.array(
        [
            [
                np.mean(middle * off[3 + i : rows - 3 + i, 3 + j : cols - 3 + j])
                for j in range(-2, 3)
            ]
            for i in range(3)
        ]
    )


def test_collected_charge_that_couples_correlates_the_noise(device: Device):
    """Against the closed form of Moore, Ninkov and Forrest: R = kernel correlated with itself.

    Each estimate from N pixels of variance s^2 scatters by s^2 sqrt(2 / N) at most (Bartlett 1946:
    at distance 0, and sum R^2 / N elsewhere is less); the z of 1 - LEVEL over all 15.
    """
    plain = flat_frame(device, None)
    coupled = flat_frame(device, ELECTRICAL)
    variance, count = plain.mean(), plain.size  # Poisson
    closed = autocorrelation(np.array(CAPACITANCE))[2:, :]
    bound = norm.isf(LEVEL / 30) * np.sqrt(2 / count)
    assert_close(correlations(coupled) / variance, closed, atol=bound)
    assert coupled.mean() == pytest.approx(0.98 * plain.mean(), rel=1e-4)
    # The controls: noise that is not coupled, and light that spreads before it is counted, are
    # white; with the latter the photon transfer keeps its slope.
    for frame in (plain, flat_frame(device, Crosstalk(optical=Kernels({"*": CAPACITANCE})))):
        white = correlations(frame) / frame.mean()
        assert_close(white[0, 2], np.array(1.0), atol=bound)
        assert np.abs(white - closed).max() > 2 * bound
    assert closed[0, 3] > 2 * bound  # what tells them apart


@pytest.mark.parametrize("noise", [True, False])
@pytest.mark.parametrize("spread", ["optical", "electrical", "both"])
def test_strips_and_tiles_change_not_one_bit(device: Device, spread: str, noise: bool):
    """With PRNU, dark current, shot and read noise, each rectangle from the light that it needs."""
    optical = kernels_of(BAYER, 5) if spread != "electrical" else None
    electrical = Kernels({"*": CAPACITANCE}) if spread != "optical" else None
    camera = sensor(40, 64, crosstalk=Crosstalk(optical=optical, electrical=electrical))
    stages = {
        "mosaic",
        *(("crosstalk",) * bool(optical)),
        *(("electrical crosstalk",) * bool(electrical)),
    }
    stages |= {"noise", "prnu", "dsnu", "read noise"} if noise else set()
    sites = np.random.default_rng(3).uniform(0, 1e5, (4, 20, 32)).astype(F32)

    def made(rect) -> dict[str, np.ndarray]:
        lit = aligned(rects_of(rect, camera, stages.__contains__)[1], 2)
        row, col, rows, cols = (side // 2 for side in lit)
        part = np.ascontiguousarray(sites[:, row : row + rows, col : col + cols])
        rec = Recording(device)
        planes, glare = rec.buffer("planes", part.shape, F32), rec.buffer("glare", 4, F32)
        rec.upload(planes, part)
        rec.clear(glare)
        shot = Shot(0.01, 3, 0)
        found = record_readout(
            rec,
            SiteLight(planes, glare, lit),
            camera,
            rect,
            shot=shot,
            runs=stages.__contains__,
        )
        if not (noise or electrical):
            del found["mean"]  # the electrons themselves
        labels = {name: rec.download(array) for name, array in found.items()}
        result = rec.run()
        return {name: result[label] for name, label in labels.items()}

    whole = made((0, 0, 40, 64))
    assert whole["electrons"].std() > 0
    for rect in ((0, 0, 7, 64), (7, 0, 1, 64), (39, 60, 1, 4), (11, 13, 17, 21)):
        collecting, taking = rects_of(rect, camera, stages.__contains__)
        for name, found in made(rect).items():
            row, col, rows, cols = {"rate": taking, "mean": collecting}.get(name, rect)
            part = whole[name][row : row + rows, col : col + cols]
            assert_close(found, part.copy(), atol=0)


def test_a_tile_of_a_frame_is_part_of_the_whole_bit_for_bit():
    """Through a lens; the rate is that of the light, before the cross-talk."""
    both = Crosstalk(optical=kernels_of(BAYER, 5), electrical=Kernels({"*": CAPACITANCE}))
    camera = StubCamera(bank(), sensor(32, 48, crosstalk=both))
    renderer = Renderer(camera, scene(shapes()), Accuracy(1e-2, 0), method="fft")
    try:
        assert renderer.plan.runs("crosstalk") and renderer.plan.runs("electrical crosstalk")
        lines = renderer.plan.text()
        assert "5 x 5 pixels" in lines and "3 x 3 pixels" in lines
        whole = renderer.capture(EXPOSURE, keep=("rate", "electrons"))
        tiled = renderer.capture(EXPOSURE, tile_px=25, keep=("rate", "electrons"))
        part = renderer.capture(EXPOSURE, tile=(21, 10, 13, 9), keep=("rate", "electrons"))
    finally:
        renderer.release()
    for name in ("rate", "electrons", "raw"):
        assert_close(getattr(tiled, name), getattr(whole, name), atol=0)
        assert_close(getattr(part, name), getattr(whole, name)[10:19, 21:34].copy(), atol=0)
    assert whole.electrons.mean() < 0.9 * EXPOSURE * whole.rate.mean()


def test_a_sensor_without_cross_talk_does_not_run_it():
    camera = StubCamera(bank(), sensor(32, 48))
    renderer = Renderer(camera, scene(shapes()), Accuracy(1e-2, 0), method="fft")
    try:
        assert not renderer.plan.runs("crosstalk")
        assert not renderer.plan.runs("electrical crosstalk")
        assert "crosstalk" not in renderer.capture(EXPOSURE).times_s
    finally:
        renderer.release()


# Wrong files


@pytest.mark.parametrize(
    ("optical", "said", "allowed"),
    [
        ({}, "no kernel", "by pair"),
        ({"*": [[0.1, 0.9]]}, "1 x 2", "odd sides"),
        ({"*": [[0.0] * 9]}, "1 x 9", "up to 7"),
        ({"*": [[0.1, 0.8], [0.1]]}, "no rectangle", "equal length"),
        ({"*": [[]]}, "1 x 0", "odd sides"),
        ({"*": [[-0.1, 1.0, 0.1]]}, "negative", "0 to 1"),
        ({"*": [[0.1, 0.9, 0.1]]}, "gives more signal", "1 or less"),
        ({"R>G": [[0.1, 0.0, 0.1]]}, "pixel of R gives more", "1 or less"),
        ({"RG": [[1.0]]}, "'RG' names no pair", "R>G"),
        ({"R>": [[1.0]]}, "'R>' names no pair", "R>G"),
        ({"R>C": [[0.1, 0.0, 0.1]]}, "no channel C", "B, G, R"),
        ({"R>G": [[0.1, 0.2, 0.1]]}, "in its middle", "0 there"),
    ],
)
def test_wrong_kernels_are_named_with_what_is_allowed(tmp_path, optical, said, allowed):
    file = sensor_file(tmp_path, crosstalk={"optical": optical})
    with pytest.raises(UserError) as caught:
        load_sensor(file)
    assert caught.value.file == file
    assert said in caught.value.problem and allowed in caught.value.allowed


def test_cross_talk_without_kernels_and_unknown_fields_are_refused(tmp_path):
    with pytest.raises(UserError, match="no kernels"):
        load_sensor(sensor_file(tmp_path, crosstalk={}))
    with pytest.raises(UserError, match="unknown field") as caught:
        load_sensor(sensor_file(tmp_path, crosstalk={"optic": {"*": [[1.0]]}}))
    assert caught.value.allowed == "optical, electrical"


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/crosstalk", PY=2, PX=2).workgroup_size == (64, 1, 1)
