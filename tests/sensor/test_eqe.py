"""The quantum efficiency by angle: its file, and a clear screen for each mistake in it."""

import json
from pathlib import Path

import numpy as np
import pytest
from changes import sensor_file
from optics.angled import sample

from gpusim.errors import UserError
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.eqe_model import EqeMap, MicroLens, read_eqe
from gpusim.sensor.load import PRESETS, load_sensor
from gpusim.sensor.sensor import Sensor

NAN = float("nan")


def content(**changes: object) -> dict:
    """Return a small file: two wavelengths, three thetas, four phis."""
    cube = [[[0.5] * 4, [0.4] * 4, [0.3, 0.2, 0.3, 0.4]]] * 2
    return {
        "source": "made up",
        "wavelengths_nm": [400, 700],
        "theta_deg": [0, 20, 40],
        "phi_deg": [0, 90, 180, 270],
        "channels": {name: cube for name in "RGB"},
    } | changes


def written(tmp_path: Path, data: object, **fields: object) -> Path:
    """Write a sensor whose quantum efficiency is a file of this content."""
    (tmp_path / "eqe.json").write_text(data if isinstance(data, str) else json.dumps(data))
    given = {"quantum_efficiency": ..., "eqe_map": {"file": "eqe.json"}} | fields
    return sensor_file(tmp_path, (("sources", "quantum_efficiency"), ...), **given)


def test_a_map_is_read_and_gives_the_quantum_efficiency_at_normal_incidence(tmp_path):
    sensor = load_sensor(written(tmp_path, content()))
    assert sensor.eqe_map.file == "eqe.json"
    assert sensor.qe["G"] == pytest.approx(np.full(61, 0.5))
    found = sensor.eqe_map.on_grid(WAVELENGTHS_NM)["G"]
    assert found.shape == (WAVELENGTHS_NM.size, 3, 4)
    assert found[30, 2].tolist() == [0.3, 0.2, 0.3, 0.4]
    # What the report keeps is the same sensor.
    assert Sensor.model_validate(sensor.model_dump()) == sensor
    assert sensor.roi(10, 20).eqe_map is sensor.eqe_map


def test_the_external_efficiency_is_the_product_of_its_factors(tmp_path):
    cube = content()["channels"]["R"]
    half = (0.5 * np.array(cube)).tolist()
    sensor = load_sensor(
        written(tmp_path, content(channels={"R": {"oe": cube, "iqe": half}, "G": cube, "B": cube}))
    )
    assert np.array_equal(sensor.eqe_map.eqe("R"), 0.5 * sensor.eqe_map.eqe("G") ** 2)


def test_wavelengths_are_interpolated(tmp_path):
    cube = [[[0.2]], [[0.6]]]
    data = content(phi_deg=[0], channels={n: [[*one, *one] for one in cube] for n in "RGB"})
    found = load_sensor(written(tmp_path, data | {"theta_deg": [0, 60]})).eqe_map
    assert found.on_grid(WAVELENGTHS_NM)["B"][:, 1, 0] == pytest.approx(np.linspace(0.2, 0.6, 61))


def replaced(index: tuple, value: object) -> dict:
    data = json.loads(json.dumps(content()))
    place = data["channels"]["G"]
    for step in index[:-1]:
        place = place[step]
    place[index[-1]] = value
    return data


def without(name: str) -> dict:
    return {key: value for key, value in content().items() if key != name}


@pytest.mark.parametrize(
    ("data", "field", "said"),
    [
        (without("wavelengths_nm"), "wavelengths_nm", "missing"),
        (without("theta_deg"), "theta_deg", "missing"),
        (without("phi_deg"), "phi_deg", "missing"),
        (without("channels"), "channels", "missing"),
        (content(theta=[0]), "theta", "unknown"),
        (content(wavelengths_nm=[700, 400]), "wavelengths_nm", "rise"),
        (content(wavelengths_nm=[450, 700]), "wavelengths_nm", "too soon"),
        (content(theta_deg=[0, 40, 20]), "theta_deg", "rise"),
        (content(theta_deg=[5, 20, 40]), "theta_deg", "rise"),
        (content(theta_deg=[0, 20, 95]), "theta_deg", "rise"),
        (content(phi_deg=[0, 90, 180, 170]), "phi_deg", "around"),
        (content(phi_deg=[0, 30, 60, 90]), "phi_deg", "around"),
        (content(phi_deg=[0, 90, 180, 360]), "phi_deg", "around"),
        (content(phi_deg=[]), "phi_deg", "around"),
        (content(theta_deg=[0, 40]), None, "channel R"),
        (replaced((1, 2, 3), -0.1), "channels.G.eqe.2.3.4", "wrong"),
        (replaced((1, 2, 3), NAN), "channels.G.eqe.2.3.4", "wrong"),
        (replaced((1, 2, 3), "x"), "channels.G.eqe.2.3.4", "wrong"),
        (replaced((1, 2), [0.1]), None, "channel G"),
        (content(channels={"R": {"oe": [[[1]]]}}), "channels.R", "oe"),
        ([1, 2], None, ""),
    ],
)
def test_a_wrong_file_is_refused_by_its_name_and_field(tmp_path, data, field, said):
    with pytest.raises(UserError) as error:
        load_sensor(written(tmp_path, data))
    assert error.value.file == tmp_path / "eqe.json"
    assert error.value.field == field
    assert said in error.value.problem
    assert error.value.allowed


def test_what_is_no_json_is_refused_with_its_line(tmp_path):
    with pytest.raises(UserError, match="not JSON") as error:
        load_sensor(written(tmp_path, '{\n"theta_deg": [0,,]\n}'))
    assert (error.value.file.name, error.value.field) == ("eqe.json", "line 2")


def test_a_missing_file_is_named(tmp_path):
    file = written(tmp_path, content(), eqe_map={"file": "none.json"})
    with pytest.raises(UserError, match="cannot be read") as error:
        load_sensor(file)
    assert error.value.file == tmp_path / "none.json"


def test_channels_that_are_not_those_of_the_pattern_are_refused(tmp_path):
    cube = content()["channels"]["R"]
    data = content(channels={name: cube for name in ("R", "Gr", "Gb", "B")})
    with pytest.raises(UserError) as error:
        load_sensor(written(tmp_path, data))
    assert (error.value.file.name, error.value.field) == ("eqe.json", "channels")
    assert (error.value.value, error.value.allowed) == ("B, Gb, Gr, R", "B, G, R")
    pattern = {"pattern": [["B", "Gb"], ["Gr", "R"]]}
    assert load_sensor(written(tmp_path, data, cfa=pattern)).channels == ("R", "Gb", "Gr", "B")


def test_more_electrons_than_photons_are_warned_of_by_name(tmp_path):
    with pytest.warns(UserWarning, match="efficiency of G exceeds 1: 1.5 at 700 nm, theta 40, phi"):
        load_sensor(written(tmp_path, replaced((1, 2, 3), 1.5)))


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"quantum_efficiency": {"wavelengths_nm": [400, 700], "channels": {}}}, "eqe_map"),
        ({"eqe_map": {"file": "eqe.json", "theta_deg": [0]}}, "eqe_map"),
        ({"micro_lens": {"heights_mm": [0, 1], "chief_ray_deg": [0]}}, "micro_lens.chief_ray_deg"),
        ({"micro_lens": {"heights_mm": [0, 1], "chief_ray_deg": [1, 2]}}, "micro_lens"),
        ({"micro_lens": {"heights_mm": [0, 0], "chief_ray_deg": [0, 2]}}, "micro_lens"),
        ({"micro_lens": {"heights_mm": [0, 1], "chief_ray_deg": [0, 91]}}, "micro_lens"),
    ],
)
def test_fields_that_do_not_go_together_are_refused(tmp_path, fields, field):
    with pytest.raises(UserError) as error:
        load_sensor(written(tmp_path, content(), **fields))
    assert error.value.file == tmp_path / "sensor.yaml"
    assert error.value.field == field


def test_micro_lenses_need_a_map(tmp_path):
    file = sensor_file(tmp_path, micro_lens={"heights_mm": [0, 1], "chief_ray_deg": [0, 10]})
    with pytest.raises(UserError, match="no eqe_map") as error:
        load_sensor(file)
    assert error.value.field == "micro_lens"


def test_the_micro_lenses_curve_is_straight_between_and_stays_beyond():
    found = MicroLens(heights_mm=[0, 1, 2], chief_ray_deg=[0, 20, 30])
    angles = np.degrees(np.arcsin(found.sine(np.array([0.0, 500.0, 1500.0, 9000.0]))))
    assert angles == pytest.approx([0, 10, 25, 30])


def test_a_table_of_one_channel_is_named_with_what_it_should_have(tmp_path):
    (tmp_path / "eqe.json").write_text(json.dumps(content(theta_deg=[0, 10])))
    with pytest.raises(UserError) as error:
        read_eqe(tmp_path / "eqe.json")
    assert error.value.allowed == "2 wavelengths of 2 thetas of 4 phis"
    assert isinstance(EqeMap.model_validate(content()), EqeMap)


def test_the_sample_is_the_model_that_it_says():
    file = PRESETS / "eqe-sample.json"
    assert json.loads(file.read_text()) == sample()
    found = load_sensor("eqe-sample")
    assert found.channels == ("R", "Gb", "Gr", "B")
    assert "made up" in found.eqe_map.source
    # Gr and Gb are mirror images along the rows: phi and 180 - phi.
    mirror = [(6 - number) % 12 for number in range(12)]
    gr, gb = found.eqe_map.eqe("Gr"), found.eqe_map.eqe("Gb")
    assert np.abs(gr[..., mirror] - gb).max() <= 1e-4  # four digits
