"""Lens files that state the axis alone, as those of stock achromats do, work over a small field."""

import numpy as np
import pytest
from formats.written import seq_text, zmx_text
from lens.made import lens

from gpusim.camera import load_camera
from gpusim.errors import UserError
from gpusim.formats.imported import SMALL_FIELD_DEG
from gpusim.formats.lens_file import load_prescription
from gpusim.lens.system import first_order
from gpusim.psf.compute import compute_bank


def achromat(**fields):
    """Return a cemented doublet of f = 40 mm at f/8, its stop at the front."""
    rows = [
        {"radius": 30.6, "thickness": 6.0, "glass": "N-BAF10", "semi_diameter": 12.0},
        {"radius": -22.6, "thickness": 1.5, "glass": "N-SF10", "semi_diameter": 12.0},
        {"radius": -120.0, "semi_diameter": 12.0},
    ]
    return lens(rows, glass_catalogues=["SCHOTT"], f_number=8.0, max_field_deg=0.0, **fields)


def over_the_field(one):
    """Return a bank of few fields, the first on the axis and the last at the edge."""
    fields_deg = np.linspace(0.0, one.max_field_deg, 5)
    return compute_bank(one, [450.0, 550.0, 650.0], fields_deg, size=64)


@pytest.fixture
def file(tmp_path):
    one = achromat()
    path = tmp_path / "achromat.zmx"
    path.write_text(zmx_text(one, first_order(one).bfl_mm))
    return path


@pytest.mark.parametrize("kind", ["zmx", "seq"])
def test_a_file_with_the_axis_alone_makes_a_bank(tmp_path, kind):
    one = achromat()
    path = tmp_path / f"achromat.{kind}"
    path.write_text({"zmx": zmx_text, "seq": seq_text}[kind](one, first_order(one).bfl_mm))
    read = load_prescription(path)
    assert read.states_axis_alone
    assert read.max_field_deg == SMALL_FIELD_DEG == 2.0
    said = [text for text in read.import_log.listed("substituted") if "axis alone" in text]
    assert said == [
        "file: field on the axis alone: by 2 deg, a small field; a camera takes its sensor's"
    ]
    assert said[0].removeprefix("file: ") in read.history[-1]
    bank = compute_bank(read, [550.0], size=64)
    assert bank.field_deg[-1] == 2.0
    # f tan(theta), for a thin lens at its stop has no distortion (Welford, Aberrations of Optical
    # Systems, sec. 12.4); but the image plane is the focus of the d line, and the ideal height that
    # of 550 nm: measured 1.6e-3.
    assert bank.image_circle_um == pytest.approx(bank.ideal_height_um[-1], rel=2e-3)


def test_a_camera_takes_such_a_lens_to_the_corners_of_its_sensor(tmp_path, file):
    camera = tmp_path / "camera.yaml"
    for sensor in ("imx477", "{preset: imx477, rows: 480, cols: 640}"):
        camera.write_text(f"title: t\nlens: {{prescription: {file.name}}}\nsensor: {sensor}\n")
        made = load_camera(camera)
        corner_um = np.hypot(made.sensor.rows, made.sensor.cols) * made.sensor.pixel_pitch_um / 2
        bank = over_the_field(made.lens)
        # With 2 % to spare at the reference of the lens; the bank's, 550 nm, differs by less.
        assert bank.image_circle_um == pytest.approx(1.02 * corner_um, rel=2e-3)
        assert bank.real_height_um[-1].min() > corner_um
        assert "to the corners of the sensor" in made.lens.history[-1]
    # A field that the camera file states is that of the lens.
    stated = f"{{prescription: {file.name}, max_field_deg: 9.5, f_number: 10}}"
    camera.write_text(f"title: t\nlens: {stated}\nsensor: imx477\n")
    lens_ = load_camera(camera).lens
    assert lens_.max_field_deg == 9.5
    assert first_order(lens_).f_number == pytest.approx(10)


def test_a_stop_that_is_closed_does_not_shrink_the_glass_of_such_a_lens(tmp_path):
    # Without semi-diameters the glass is as large as the beam of the sensor's corner needs, not
    # that of 2 deg: the light is that of a lens of 12 mm glasses, which pass all of it.
    one = achromat()
    bare = tuple(s.model_copy(update={"semi_diameter": None}) for s in one.surfaces)
    light = []
    for name, surfaces in (("bare", bare), ("large", one.surfaces)):
        text = zmx_text(one.model_copy(update={"surfaces": surfaces}), first_order(one).bfl_mm)
        (tmp_path / f"{name}.zmx").write_text(text)
        camera = tmp_path / "camera.yaml"
        camera.write_text(
            f"title: t\nlens: {{prescription: {name}.zmx, f_number: 10}}\nsensor: imx249-mono\n"
        )
        made = load_camera(camera).lens
        assert made.max_field_deg > 4 * SMALL_FIELD_DEG
        bank = over_the_field(made)
        light.append(bank.field_light / bank.field_light[0])
    # Computed apertures touch the outermost ray: a share of 1e-3 of the pupil's cells lies there.
    np.testing.assert_allclose(light[0], light[1], rtol=1e-3)


def test_a_sensor_that_no_chief_ray_reaches_is_refused(tmp_path, file):
    # A tube of 0.7 mm, 30 mm behind the lens: the chief ray at h passes at about 3/4 h.
    one = load_prescription(file)
    air = {"radius": np.inf, "thickness": 6.0, "semi_diameter": 0.7}
    rows = [*(s.model_dump(exclude_none=True) for s in achromat().surfaces), air]
    rows[2]["thickness"] = 30.0
    text = zmx_text(
        lens(rows, glass_catalogues=["SCHOTT"], f_number=40.0, max_field_deg=0.0), 6.0
    ).replace("  DIAM 0.7", "  CLAP 0 0.7\n  DIAM 0.7")
    (tmp_path / "tube.zmx").write_text(text)
    opened = load_prescription(tmp_path / "tube.zmx")
    # 30 mm tan(theta) < 0.7 mm up to 1.3 deg: half of 2 deg.
    assert opened.max_field_deg == 1.0
    camera = tmp_path / "camera.yaml"
    camera.write_text("title: t\nlens: tube.zmx\nsensor: imx249-mono\n")
    with pytest.raises(UserError) as caught:
        load_camera(camera)
    for word in ("axis alone", "corners of the sensor", "tube.zmx", "corner at", "fewer pixels"):
        assert word in caught.value.screen()
    assert one.max_field_deg == 2.0


def test_a_lens_that_passes_nothing_off_its_axis_is_refused(tmp_path):
    rows = [*(s.model_dump(exclude_none=True) for s in achromat().surfaces)]
    rows[2]["thickness"] = 30.0
    rows.append({"radius": np.inf, "thickness": 6.0, "semi_diameter": 0.01})
    text = zmx_text(
        lens(rows, glass_catalogues=["SCHOTT"], f_number=40.0, max_field_deg=0.0), 6.0
    ).replace("  DIAM 0.01", "  CLAP 0 0.01\n  DIAM 0.01")
    path = tmp_path / "pinhole.zmx"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        load_prescription(path)
    for word in ("axis alone", "no chief ray", "pinhole.zmx", "max_field_deg"):
        assert word in caught.value.screen()


def test_what_is_wrong_on_the_axis_is_said_as_it_is(tmp_path, file):
    wrong = tmp_path / "wrong.zmx"
    wrong.write_text(file.read_text().replace("N-BAF10", "N-BAF99"))
    with pytest.raises(UserError, match="N-BAF99"):
        load_prescription(wrong)
