"""Reading photographs: what is honoured, what is refused, and what is said about it."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from harness import assert_close

from gpusim.errors import UserError
from gpusim.scene import make_scene
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, rgb_to_xyz
from gpusim.scene.exr import BETWEEN, read_exr, write_exr

ACES_AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
ACES_AP1 = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
SAMPLES = Path(__file__).resolve().parents[3] / "shared" / "data"


def write(path: Path, channels: dict, **header: object) -> Path:
    storage = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(storage | header, channels).write(str(path))
    return path


def picture(rows: int = 5, cols: int = 7) -> np.ndarray:
    return np.random.default_rng(4).uniform(0, 2, (rows, cols, 3)).astype(np.float32)


def planes_first(rgb: np.ndarray) -> np.ndarray:
    return np.moveaxis(rgb, -1, 0).copy()


def test_what_was_written_is_read_back(tmp_path):
    rgb = picture()
    write_exr(tmp_path / "a.exr", {"RGB": rgb}, 120.0)
    photograph = read_exr(tmp_path / "a.exr")
    assert photograph.rgb.dtype == np.float32
    assert_close(photograph.rgb, planes_first(rgb), atol=0)
    assert photograph.white_luminance_cd_m2 == 120.0
    assert photograph.white_rgb == (1.0, 1.0, 1.0)
    assert photograph.notes == ()


def test_write_exr_keeps_other_planes_by_name(tmp_path):
    plane = np.arange(12, dtype=np.float32).reshape(3, 4)
    write_exr(tmp_path / "a.exr", {"electrons": plane})
    channels = OpenEXR.File(str(tmp_path / "a.exr")).channels()
    assert list(channels) == ["electrons"]
    assert_close(channels["electrons"].pixels, plane, atol=0)


def test_half_floats_alpha_and_other_channels_are_read_or_ignored(tmp_path):
    rgb = picture().astype(np.float16)
    alpha = np.full(rgb.shape[:2], 0.5, np.float16)
    channels = {"R": rgb[..., 0], "G": rgb[..., 1], "B": rgb[..., 2], "A": alpha, "Z": alpha}
    path = write(tmp_path / "a.exr", {k: np.ascontiguousarray(v) for k, v in channels.items()})
    assert_close(read_exr(path).rgb, planes_first(rgb), atol=0)
    assert read_exr(path).white_luminance_cd_m2 is None


def test_tiles_are_read(tmp_path):
    rgb = picture(70, 90)
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 32
    path = write(tmp_path / "a.exr", {"RGB": rgb}, type=OpenEXR.tiledimage, tiles=tiles)
    assert_close(read_exr(path).rgb, planes_first(rgb), atol=0)


def test_luminance_alone_is_grey(tmp_path):
    plane = picture()[..., 0].copy()
    photograph = read_exr(write(tmp_path / "a.exr", {"Y": plane}))
    assert_close(photograph.rgb, np.stack([plane] * 3), atol=0)


def test_the_first_part_with_a_picture_is_read(tmp_path):
    rgb = picture()
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    parts = [
        OpenEXR.Part(header | {"name": "depth"}, {"Z": rgb[..., 0].copy()}),
        OpenEXR.Part(header | {"name": "beauty"}, {"RGB": rgb}),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    assert_close(read_exr(tmp_path / "a.exr").rgb, planes_first(rgb), atol=0)


@pytest.mark.parametrize("chromaticities", [ACES_AP0, ACES_AP1], ids=["AP0", "AP1"])
def test_other_primaries_keep_their_xyz(tmp_path, chromaticities):
    # Near-neutral: inside Rec.709 whatever the primaries.
    rgb = (0.5 + 0.05 * picture()).astype(np.float32)
    path = write(tmp_path / "a.exr", {"RGB": rgb}, chromaticities=chromaticities)
    photograph = read_exr(path)
    # The file holds float32 chromaticities: 2^-24 relative in each, carried through quotients by
    # matrices of condition below 20; and the result is float32.
    xyz = rgb.astype(np.float64) @ rgb_to_xyz(np.float32(chromaticities)).T
    ours = photograph.rgb.transpose(1, 2, 0) @ rgb_to_xyz(REC709_CHROMATICITIES).T
    assert_close(ours, xyz, rtol=20 * 2.0**-24 + 4 * 2.0**-24)
    white = rgb_to_xyz(REC709_CHROMATICITIES) @ photograph.white_rgb
    assert_close(white, rgb_to_xyz(chromaticities).sum(axis=1), rtol=20 * 2.0**-24)
    assert "primaries" in photograph.notes[0]


def test_rec709_primaries_change_nothing(tmp_path):
    rgb = picture()
    path = write(tmp_path / "a.exr", {"RGB": rgb}, chromaticities=REC709_CHROMATICITIES)
    assert_close(read_exr(path).rgb, planes_first(rgb), atol=0)
    assert read_exr(path).notes == ()


def test_a_colour_outside_rec709_keeps_its_luminance_and_direction(tmp_path):
    rgb = np.full((2, 2, 3), 0.25, np.float32)
    rgb[0, 1] = 0, 1, 0  # the green of AP1: outside Rec.709
    path = write(tmp_path / "a.exr", {"RGB": rgb}, chromaticities=ACES_AP1)
    photograph = read_exr(path)
    to_rec709 = np.linalg.solve(rgb_to_xyz(REC709_CHROMATICITIES), rgb_to_xyz(ACES_AP1))
    before, after = to_rec709 @ [0, 1, 0], photograph.rgb[:, 0, 1].astype(np.float64)
    weights = rgb_to_xyz(REC709_CHROMATICITIES)[1]
    luminance = weights @ before
    assert before.min() < -0.1
    assert after.min() == pytest.approx(0, abs=1e-7)  # on the boundary, in float32
    assert weights @ after == pytest.approx(luminance, rel=2.0**-22)
    share = (after - luminance) / (before - luminance)
    assert_close(share, np.full(3, share.mean()), atol=1e-5)  # float32 over a difference of 0.1
    assert any("1 pixels outside Rec.709" in note for note in photograph.notes)


def test_a_small_negative_is_noise_of_the_file(tmp_path):
    rgb = np.ones((4, 4, 3), np.float32)
    rgb[2, 1] = 1, -9e-4, 1
    photograph = read_exr(write(tmp_path / "a.exr", {"RGB": rgb}))
    assert photograph.rgb.min() == 0
    assert "1 pixels" in photograph.notes[0]
    rgb[3, 3] = -9e-4  # no luminance at all: black
    photograph = read_exr(write(tmp_path / "a.exr", {"RGB": rgb}))
    assert_close(photograph.rgb[:, 3, 3], np.zeros(3), atol=0)


@pytest.mark.parametrize(
    ("value", "problem"),
    [(np.nan, "NaN"), (np.inf, "infinite"), (1e38, "beyond"), (-1e38, "beyond")],
)
def test_samples_that_no_radiance_has_are_refused(tmp_path, value, problem):
    rgb = picture()
    rgb[3, 2, 2] = rgb[4, 1, 2] = value
    path = write(tmp_path / "a.exr", {"RGB": rgb})
    with pytest.raises(UserError, match=problem) as caught:
        read_exr(path)
    assert caught.value.file == path
    assert caught.value.field == "channel B"
    assert caught.value.value.startswith("2 samples, first")
    assert "row 3, column 2" in caught.value.value


def test_negatives_of_a_wide_gamut_are_moved_into_it_and_counted(tmp_path):
    rgb = np.ones((5, 5, 3), np.float32)
    rgb[2, 1] = 0.2, 1.0, -0.3
    rgb[3, 3] = -0.5  # no luminance at all: black
    photograph = read_exr(write(tmp_path / "a.exr", {"RGB": rgb}))
    assert "2 pixels outside Rec.709 or negative" in photograph.notes[0]
    weights = rgb_to_xyz(REC709_CHROMATICITIES)[1]
    found = photograph.rgb[:, 2, 1].astype(float)
    assert found.min() == pytest.approx(0, abs=1e-7)
    assert weights @ found == pytest.approx(weights @ rgb[2, 1].astype(float), rel=2.0**-22)
    assert_close(photograph.rgb[:, 3, 3], np.zeros(3), atol=0)
    grey = np.array([[1.0, -0.25]], np.float32)
    photograph = read_exr(write(tmp_path / "b.exr", {"Y": grey}))
    assert_close(photograph.rgb, np.stack([[[1.0, 0.0]]] * 3), atol=0)
    assert "1 pixels" in photograph.notes[0]


def damaged(path: Path, how: str) -> Path:
    if how == "missing":
        return path
    write_exr(path, {"RGB": picture(200, 300)})
    data = path.read_bytes()
    damage = {
        "text": b"not an image at all\n",
        "empty": b"",
        "header only": data[:200],
        "cut": data[: len(data) // 2],
        "overwritten": data[:20000] + b"\xff" * 5000 + data[25000:],
    }
    path.write_bytes(damage[how])
    return path


@pytest.mark.parametrize("how", ["missing", "text", "empty", "header only", "cut", "overwritten"])
def test_a_damaged_file_is_one_clear_error_and_nothing_else(tmp_path, capfd, how):
    path = damaged(tmp_path / "a.exr", how)
    with pytest.raises(UserError, match=r"readable|no such") as caught:
        read_exr(path)
    assert caught.value.file == path
    assert capfd.readouterr() == ("", "")


def test_a_file_without_picture_channels_is_refused(tmp_path):
    path = write(tmp_path / "a.exr", {"left.R": picture()[..., 0].copy()})
    with pytest.raises(UserError, match="no picture channels") as caught:
        read_exr(path)
    assert caught.value.value == "left.R"


def attribute(name: str, kind: str, data: bytes) -> bytes:
    return b"\0".join([name.encode(), kind.encode(), struct.pack("<i", len(data)) + data])


def write_sampled(path: Path, planes: dict, first: tuple[int, int] = (0, 0)) -> Path:
    """Write an EXR by its file layout: Y at every pixel, others at every other row and column."""
    rows, cols = planes["Y"].shape
    step = {name: 1 if plane.shape == (rows, cols) else 2 for name, plane in planes.items()}
    channels = b"".join(
        name.encode() + b"\0" + struct.pack("<iiii", 2, 0, step[name], step[name])
        for name in sorted(planes)
    )
    y0, x0 = first
    box = struct.pack("<4i", x0, y0, x0 + cols - 1, y0 + rows - 1)
    head = struct.pack("<ii", 20000630, 2) + b"".join(
        [
            attribute("channels", "chlist", channels + b"\0"),
            attribute("compression", "compression", b"\0"),
            attribute("dataWindow", "box2i", box),
            attribute("displayWindow", "box2i", box),
            attribute("lineOrder", "lineOrder", b"\0"),
            attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
            attribute("screenWindowCenter", "v2f", bytes(8)),
            attribute("screenWindowWidth", "float", struct.pack("<f", 1)) + b"\0",
        ]
    )
    lines = []
    for row in range(rows):
        data = b"".join(
            planes[name][row // step[name]].astype("<f4").tobytes()
            for name in sorted(planes)
            if (y0 + row) % step[name] == 0
        )
        lines.append(struct.pack("<ii", y0 + row, len(data)) + data)
    places = len(head) + 8 * rows + np.cumsum([0, *map(len, lines)])[:-1]
    path.write_bytes(head + places.astype("<u8").tobytes() + b"".join(lines))
    return path


@pytest.mark.parametrize("step", [1, 2])
def test_luminance_with_chroma_is_read(tmp_path, step):
    # Chroma that varies slowly: the filter between its samples has lost nothing of it.
    row, col = np.indices((48, 64))
    red, blue = (0.4 + 0.3 * np.sin(2 * np.pi * at / 64) for at in (row, col + 20))
    weights = rgb_to_xyz(REC709_CHROMATICITIES)[1]
    y = np.random.default_rng(1).uniform(0.5, 2, row.shape)
    rgb = np.stack([y * red, np.zeros_like(y), y * blue])
    rgb[1] = (y - weights[0] * rgb[0] - weights[2] * rgb[2]) / weights[1]
    planes = {"Y": y, "RY": (red - 1)[::step, ::step], "BY": (blue - 1)[::step, ::step]}
    found = read_exr(write_sampled(tmp_path / "a.exr", planes)).rgb
    # Beside the edges (13 samples) OpenEXR repeats the last chroma. Inside, its filter takes a wave
    # of 64 samples for `gain` times it, along each axis; chroma has 0.3, luminance 2 at most.
    gain = 2 * np.cos(2 * np.pi * np.arange(1, 15, 2) / 64) @ BETWEEN
    inner = np.s_[:, 14:-14, 14:-14]
    lost = 0.3 * 2 * abs(1 - gain)
    assert lost < 2e-3
    assert_close(found[inner], rgb[inner], atol=1e-6 + (lost if step == 2 else 0))
    assert_close(found, rgb, atol=0.3)


def test_oblong_pixels_are_refused(tmp_path):
    path = write(tmp_path / "a.exr", {"RGB": picture()}, pixelAspectRatio=2.0)
    with pytest.raises(UserError, match="oblong") as caught:
        read_exr(path)
    assert caught.value.field == "pixelAspectRatio"


CIE_XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)


def test_primaries_without_luminance_are_read(tmp_path):
    rgb = (0.5 + 0.05 * picture()).astype(np.float32)
    photograph = read_exr(write(tmp_path / "a.exr", {"RGB": rgb}, chromaticities=CIE_XYZ))
    xyz = photograph.rgb.transpose(1, 2, 0) @ rgb_to_xyz(REC709_CHROMATICITIES).T
    assert_close(xyz, rgb, rtol=20 * 2.0**-24 + 4 * 2.0**-24)  # as in the test of other primaries


def shifted(by: float) -> tuple[float, ...]:
    return (REC709_CHROMATICITIES[0] + by, *REC709_CHROMATICITIES[1:])


@pytest.mark.parametrize(("by", "converted"), [(5e-5, False), (2e-4, True), (5e-3, True)])
def test_primaries_near_rec709_are_their_own(tmp_path, by, converted):
    rgb = (0.5 + 0.05 * picture()).astype(np.float32)
    photograph = read_exr(write(tmp_path / "a.exr", {"RGB": rgb}, chromaticities=shifted(by)))
    assert bool(photograph.notes) == converted
    taken = rgb_to_xyz(np.float32(shifted(by)) if converted else REC709_CHROMATICITIES)
    ours = photograph.rgb.transpose(1, 2, 0) @ rgb_to_xyz(REC709_CHROMATICITIES).T
    assert_close(ours, rgb.astype(np.float64) @ taken.T, rtol=24 * 2.0**-24)


@pytest.mark.parametrize(
    ("chromaticities", "problem"),
    [
        ((0.0,) * 8, "on a line"),
        ((0.64, 0.33) * 3 + (0.31, 0.33), "on a line"),
        ((0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.2, 0.2), "on a line"),
        ((float("nan"), *REC709_CHROMATICITIES[1:]), "none"),
        ((float("inf"), *REC709_CHROMATICITIES[1:]), "none"),
        ((*REC709_CHROMATICITIES[:6], 0.31, 0.0), "no luminance"),
        ((*REC709_CHROMATICITIES[:6], 0.7, 0.3), "between"),
    ],
)
def test_primaries_that_make_no_colours_are_refused(tmp_path, chromaticities, problem):
    path = write(tmp_path / "a.exr", {"RGB": picture()}, chromaticities=chromaticities)
    with pytest.raises(UserError, match=problem) as caught:
        read_exr(path)
    assert caught.value.field == "chromaticities" and caught.value.file == path
    # Grey has none to convert from.
    read_exr(write(path, {"Y": picture()[..., 0].copy()}, chromaticities=chromaticities))


@pytest.mark.parametrize("value", [-5.0, 0.0, float("nan"), float("inf"), "bright"])
@pytest.mark.parametrize("channels", ["RGB", "Y"])
def test_a_luminance_of_white_that_is_none_is_refused(tmp_path, value, channels):
    rgb = picture() if channels == "RGB" else picture()[..., 0].copy()
    path = write(tmp_path / "a.exr", {channels: rgb}, whiteLuminance=value)
    with pytest.raises(UserError, match="luminance of white") as caught:
        read_exr(path)
    assert caught.value.field == "whiteLuminance" and "--luminance" in caught.value.allowed
    assert make_scene(path, 80.0).white_luminance_cd_m2 == pytest.approx(80.0)


@pytest.mark.parametrize("channels", ["RGB", "Y"])
def test_the_luminance_of_white_is_the_files(tmp_path, channels):
    rgb = picture() if channels == "RGB" else picture()[..., 0].copy()
    path = write(tmp_path / "a.exr", {channels: rgb}, whiteLuminance=120.0)
    assert read_exr(path).white_luminance_cd_m2 == 120.0
    assert make_scene(path).white_luminance_cd_m2 == pytest.approx(120.0)


def window(name: str, x0: int, y0: int, x1: int, y1: int) -> dict:
    return {name: (np.array([x0, y0], np.int32), np.array([x1, y1], np.int32))}


@pytest.mark.parametrize("name", ["displayWindow", "dataWindow"])
def test_a_window_larger_than_any_picture_is_refused_before_it_is_made(tmp_path, name):
    path = write(tmp_path / "a.exr", {"RGB": picture(48, 32)})
    box = struct.pack("<4i", 0, 0, 31, 47), struct.pack("<4i", 0, 0, 39999, 39999)
    content = path.read_bytes()
    place = content.index(name.encode())
    path.write_bytes(content[:place] + content[place:].replace(box[0], box[1], 1))
    tracemalloc.start()
    with pytest.raises(UserError, match="larger than any") as caught:
        read_exr(path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert caught.value.field == name and "40000 x 40000" in caught.value.value
    assert most < 1 << 20


def test_a_data_window_may_begin_before_the_display_window(tmp_path):
    rgb = picture(5, 7)
    both = window("dataWindow", -3, -2, 3, 2) | window("displayWindow", 0, 0, 4, 3)
    photograph = read_exr(write(tmp_path / "a.exr", {"RGB": rgb}, **both))
    expected = np.zeros((3, 4, 5), np.float32)
    expected[:, :3, :4] = planes_first(rgb)[:, 2:, 3:]
    assert_close(photograph.rgb, expected, atol=0)
    both = window("dataWindow", -9, -7, -3, -3) | window("displayWindow", -8, -6, -5, -4)
    photograph = read_exr(write(tmp_path / "a.exr", {"RGB": rgb}, **both))
    assert_close(photograph.rgb, planes_first(rgb)[:, 1:4, 1:5], atol=0)


def test_a_deep_picture_is_refused_by_name(tmp_path):
    path = write(tmp_path / "a.exr", {"RGB": picture()})
    content = path.read_bytes()
    # Flags of version 2: bit 11 says that there are deep data.
    content = content[:4] + struct.pack("<i", 2 | 1 << 11) + content[8:]
    kind = attribute("type", "string", b"scanlineimage")
    deep = attribute("type", "string", b"deepscanline") + attribute(
        "version", "int", struct.pack("<i", 1)
    )
    if kind in content:
        content = content.replace(kind, deep)
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"deep|readable") as caught:
        read_exr(path)
    assert caught.value.allowed == "scan lines or tiles, flat"


def test_the_display_window_is_what_is_seen(tmp_path):
    rgb = picture(5, 7)
    window = {
        "dataWindow": (np.array([2, 1], np.int32), np.array([8, 5], np.int32)),
        "displayWindow": (np.array([0, 3], np.int32), np.array([5, 7], np.int32)),
    }
    photograph = read_exr(write(tmp_path / "a.exr", {"RGB": rgb}, **window))
    expected = np.zeros((3, 5, 6), np.float32)
    expected[:, :3, 2:] = planes_first(rgb)[:, 2:, :4]
    assert_close(photograph.rgb, expected, atol=0)
    assert "display window" in photograph.notes[0]


def test_a_folder_that_is_not_there_is_a_clear_error(tmp_path):
    with pytest.raises(UserError, match="cannot write"):
        write_exr(tmp_path / "none" / "a.exr", {"RGB": picture()})


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.exr"
    path.mkdir()  # cannot be replaced by a file
    with pytest.raises(UserError, match="cannot write"):
        write_exr(path, {"RGB": picture()})
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]


@pytest.mark.parametrize("name", ["StillLife.exr", "Desk.exr"])
def test_sample_photographs_are_read(name):
    path = SAMPLES / name
    if not path.exists():
        pytest.skip(f"{name} of the OpenEXR sample images is not beside this checkout")
    stored = OpenEXR.File(str(path)).channels()["RGBA"].pixels[..., :3].astype(np.float64)
    photograph = read_exr(path)
    inside = (stored >= 0).all(axis=-1)
    assert_close(photograph.rgb[:, inside], planes_first(stored)[:, inside], atol=0)
    weights = rgb_to_xyz(REC709_CHROMATICITIES)[1]
    before = np.maximum(stored[~inside] @ weights, 0)
    after = weights @ photograph.rgb[:, ~inside].astype(np.float64)
    if before.size:
        assert_close(after, before, atol=1e-9, rtol=2.0**-22)
    assert photograph.rgb.min() >= 0
