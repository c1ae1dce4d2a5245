"""Reading photographs: what is honoured, what is refused, and what is said about it."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from harness import assert_close

from gpusim.errors import UserError
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, rgb_to_xyz
from gpusim.scene.exr import read_exr, write_exr

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
    ("value", "problem"), [(np.nan, "NaN"), (np.inf, "infinite"), (-0.01, "negative")]
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


def test_the_sun_excuses_no_negative(tmp_path):
    rgb = np.ones((5, 5, 3), np.float32)
    rgb[0, 0] = 1e9
    rgb[2, 1, 1] = -0.51  # 1e-3 of 500 times the median is 0.5
    with pytest.raises(UserError, match="negative") as caught:
        read_exr(write(tmp_path / "a.exr", {"RGB": rgb}))
    assert caught.value.field == "channel G" and "row 2, column 1" in caught.value.value
    rgb[2, 1, 1] = -0.49
    assert read_exr(write(tmp_path / "a.exr", {"RGB": rgb})).rgb.min() == 0


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


def test_luminance_with_chroma_is_refused(tmp_path):
    plane = picture()[..., 0].copy()
    path = write(tmp_path / "a.exr", {"Y": plane, "RY": plane, "BY": plane})
    with pytest.raises(UserError, match="no picture channels"):
        read_exr(path)


def test_oblong_pixels_are_refused(tmp_path):
    path = write(tmp_path / "a.exr", {"RGB": picture()}, pixelAspectRatio=2.0)
    with pytest.raises(UserError, match="oblong") as caught:
        read_exr(path)
    assert caught.value.field == "pixelAspectRatio"


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
