"""Cameras: a prescription, ready-made PSFs or an MTF table in front of a sensor, exactly one."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import assert_refused, gpusim
from formats.exports import write_isetcam, write_zemax
from optics.made import bank as made_bank
from optics.made import plane_bank

from gpusim.camera import load_camera
from gpusim.errors import UserError
from gpusim.plan import Accuracy, plan_optics
from gpusim.report.facts import plain
from gpusim.scene import make_scene

SENSOR = "sensor: {preset: imx477, rows: 96, cols: 128}"


def camera(folder: Path, lens: str) -> Path:
    file = folder / "camera.yaml"
    file.write_text(f"title: a camera\nlens: {lens}\n{SENSOR}\n")
    return file


def test_a_camera_takes_every_kind_of_lens(tmp_path):
    made_bank().save(tmp_path / "a.nc")
    (tmp_path / "folder").mkdir()
    write_isetcam(tmp_path / "folder")
    (tmp_path / "zemax").mkdir()
    write_zemax(tmp_path / "zemax")
    for lens, title in {
        "{bank: a.nc}": "Gaussians",
        "{bank: folder}": "made-up",
        "{bank: folder/ISETPARMS.TXT}": "made-up",
        "{bank: zemax/lens.yaml}": "Gaussians",
        "{mtf: diffraction-limited}": "Diffraction-limited f/2.8 lens by its MTF (synthetic)",
    }.items():
        one = load_camera(camera(tmp_path, lens))
        assert one.lens.title == title
        assert one.bank().image_circle_um > 124
        facts = plain(one.lens.model_dump())
        assert json.loads(json.dumps(facts))["title"] == title
    prescribed = load_camera(camera(tmp_path, "{prescription: double-gauss, f_number: 4}"))
    assert prescribed.lens.history == ("stop closed to f/4",)
    shifted = load_camera(camera(tmp_path, "{prescription: double-gauss, focus_shift_um: -20}"))
    assert shifted.lens.focus_shift_um == -20


def test_a_lens_or_a_sensor_may_be_a_name_or_a_file_alone(tmp_path):
    made_bank().save(tmp_path / "a.nc")
    (tmp_path / "folder").mkdir()
    write_isetcam(tmp_path / "folder")
    (tmp_path / "zemax").mkdir()
    write_zemax(tmp_path / "zemax")
    lenses, sensors = Path("gpusim/data/lenses"), Path("gpusim/data/sensors")
    (tmp_path / "mine.yaml").write_bytes((lenses / "cooke-triplet.yaml").read_bytes())
    (tmp_path / "chip.yaml").write_bytes((sensors / "imx477.yaml").read_bytes())
    (tmp_path / "table.yaml").write_bytes(
        Path("gpusim/data/mtf/diffraction-limited.yaml").read_bytes()
    )
    for plain_name, spelled_out in {
        "double-gauss": "{prescription: double-gauss}",
        "mine.yaml": "{prescription: mine.yaml}",
        "a.nc": "{bank: a.nc}",
        "folder": "{bank: folder}",
        "zemax/lens.yaml": "{bank: zemax/lens.yaml}",
        "diffraction-limited": "{mtf: diffraction-limited}",
        "table.yaml": "{mtf: table.yaml}",
    }.items():
        one, two = (load_camera(camera(tmp_path, name)) for name in (plain_name, spelled_out))
        assert type(one.lens) is type(two.lens)
        assert one.lens.model_dump() == two.lens.model_dump()
    file = tmp_path / "camera.yaml"
    for plain_name, spelled_out in (
        ("imx249-mono", "{preset: imx249-mono}"),
        ("chip.yaml", "{preset: chip.yaml}"),
    ):
        found = []
        for sensor in (plain_name, spelled_out):
            file.write_text(f"title: a camera\nlens: double-gauss\nsensor: {sensor}\n")
            found.append(load_camera(file).sensor)
        assert found[0] == found[1]
    for wrong, word in (("lens: nonsense", "nonsense"), ("sensor: nonsense", "nonsense")):
        both = {"lens": "double-gauss", "sensor": "imx477"} | dict([wrong.split(": ")])
        file.write_text("title: a camera\n" + "".join(f"{k}: {v}\n" for k, v in both.items()))
        with pytest.raises(UserError, match=word):
            load_camera(file)


def test_a_camera_may_ask_for_the_nearest_glasses(tmp_path):
    asked = load_camera(camera(tmp_path, "{prescription: tessar, nearest_glasses: true}")).lens
    as_it_is = load_camera(camera(tmp_path, "tessar")).lens
    assert as_it_is.surfaces[6].glass == "model"
    assert "/" in asked.surfaces[6].glass
    assert "by the nearest of the catalogues: surface 7" in asked.history[-1]


def test_a_camera_takes_a_saved_bank_over_both_directions_of_the_field(tmp_path):
    made = plane_bank(boresight_um=(5.0, -3.0))
    made.save(tmp_path / "plane.nc")
    file = camera(tmp_path, "{bank: plane.nc}")
    found = load_camera(file).bank()
    assert found.centre_um == (5.0, -3.0)
    np.testing.assert_array_equal(found.psf, made.psf)
    for name, values, word in (
        ("psf", np.full_like(made.psf, np.nan), "no numbers"),
        ("field_y_deg", made.field_y_deg[::-1], "disorder"),
        ("reference_nm", 555.0, "disorder"),
    ):
        replace(made, **{name: values}).save(tmp_path / "plane.nc")
        with pytest.raises(UserError, match=word) as caught:
            load_camera(file)
        assert name in caught.value.screen()


@pytest.mark.parametrize(
    ("lens", "words"),
    [
        ("{}", ["exactly one", "lens"]),
        ("{prescription: double-gauss, bank: a.nc}", ["exactly one"]),
        ("{bank: a.nc, mtf: diffraction-limited}", ["exactly one"]),
        ("{bank: a.nc, focal_length_mm: 8}", ["focal_length_mm", "lens.bank", "traced again"]),
        ("{bank: a.nc, focus_shift_um: 8}", ["focus_shift_um", "lens.bank"]),
        ("{bank: a.nc, f_number: 8}", ["f_number", "lens.bank"]),
        ("{bank: a.nc, nearest_glasses: true}", ["nearest_glasses", "lens.bank"]),
        ("{mtf: diffraction-limited, f_number: 8}", ["f_number", "lens.mtf"]),
        ("{mtf: diffraction-limited, max_field_deg: 8}", ["max_field_deg", "lens.mtf"]),
        ("{mtf: a.nc}", ["no table of an MTF", "lens.bank for this file"]),
        ("{bank: table.yaml}", ["a table of the MTF", "lens.mtf for this file"]),
        ("{bank: none.nc}", ["no such lens", "none.nc"]),
        ("{mtf: none}", ["no such lens", "none"]),
        ("{mtf: 3}", ["lens.mtf"]),
    ],
)
def test_what_is_no_choice_of_a_lens_is_refused(tmp_path, lens, words):
    made_bank().save(tmp_path / "a.nc")
    preset = Path(__file__).parents[1] / "gpusim" / "data" / "mtf" / "diffraction-limited.yaml"
    (tmp_path / "table.yaml").write_bytes(preset.read_bytes())
    with pytest.raises(UserError) as caught:
        load_camera(camera(tmp_path, lens))
    for word in words:
        assert word in caught.value.screen()
    assert "Value error" not in caught.value.screen()


def test_an_image_circle_that_misses_the_corners_is_taken_and_flagged(tmp_path):
    made_bank(circle_um=100.0).save(tmp_path / "a.nc")
    one = load_camera(camera(tmp_path, "{bank: a.nc}"))
    plan = plan_optics(one.bank(), one.sensor, make_scene("grey"), Accuracy(1e-2))
    # 96 x 128 pixels of 1.55 um; the lens's barrel brings the rim in by 2 %.
    row, col = np.indices((96, 128))
    black = np.mean(np.hypot(row - 47.5, col - 63.5) * 1.55 > 98.0)
    assert 0.05 < black < 0.3
    (stage,) = [stage for stage in plan.stages if stage.name == "image circle"]
    assert stage.runs and stage.reason == (
        f"the sensor reaches beyond the image circle: {black:.2%} of its pixels are black"
    )


def test_the_command_line_refuses_a_broken_lens_on_one_screen(tmp_path):
    (tmp_path / "a.nc").write_bytes(b"no bank")
    ran = gpusim("render", camera(tmp_path, "{bank: a.nc}"), "demo", "--out", tmp_path / "out")
    assert_refused(ran, "not a whole bank", "a.nc")


def test_the_preset_of_the_mtf_only_model_covers_its_sensor():
    one = load_camera("mtf-only")
    assert one.lens.kind == "MTF table"
    assert one.bank().provenance["lens_model"].startswith("MTF only")


@pytest.mark.parametrize(
    ("kind", "content", "other"),
    [
        ("lens", "title: t\nsource: s\nsurfaces: []\n", "lens: mine.yaml; sensor: imx477"),
        ("sensor", "title: t\npixel_pitch_um: 2.0\n", "sensor: mine.yaml; lens: tessar"),
    ],
)
def test_a_lens_or_a_sensor_alone_is_told_from_a_camera(tmp_path, kind, content, other):
    (tmp_path / "mine.yaml").write_text(content)
    with pytest.raises(UserError, match=f"the file of a {kind}, not of a camera") as caught:
        load_camera(tmp_path / "mine.yaml")
    assert other in caught.value.allowed
