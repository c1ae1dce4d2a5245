"""The front door: what `import gpusim` gives, and how light it is."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from sampling import one_in

import gpusim as gs
from gpusim.errors import UserError
from gpusim.sensor.load import load_sensor
from gpusim.sensor.noise_model import Masks

# What an `import gpusim` must not bring along: seconds, and a graphics driver.
HEAVY = ("numpy", "scipy", "wgpu", "matplotlib", "pydantic", "xarray")


def test_importing_brings_nothing_heavy():
    code = f"import sys, gpusim; print([n for n in {HEAVY!r} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there_and_documented():
    for name in gs.__all__:
        assert getattr(gs, name).__doc__, name
    assert set(gs.__all__) <= set(dir(gs))
    with pytest.raises(AttributeError, match="Lenss"):
        gs.Lenss  # noqa: B018
    assert (Path(gs.__file__).parent / "py.typed").is_file()


def pages() -> dict[str, list[str]]:
    """Return what docs/api.md has pages of, by its whole name, with the members it lists."""
    text = (Path(__file__).parents[2] / "docs" / "api.md").read_text()
    found = re.findall(r"^::: (\S+)(?:\n    options:\n      members: \[(.*)\])?", text, re.M)
    return {name: members.split(", ") if members else [] for name, members in found}


PAGES = pages()


def named(whole: str) -> object:
    module, _, name = whole.rpartition(".")
    return getattr(importlib.import_module(module), name)


def documented(whole: str) -> dict[str, object]:
    """Return a page's value and its functions, by name: those listed, or all that are public."""
    value = named(whole)
    listed = PAGES[whole] or [
        name
        for name, one in vars(value).items()
        if name[0] != "_" and (inspect.isfunction(one) or isinstance(one, classmethod))
    ]
    return {whole: value} | {f"{whole}.{name}": getattr(value, name) for name in listed}


def test_every_public_name_has_a_page_and_an_example():
    described = {id(named(whole)) for whole in PAGES}
    assert [name for name in gs.__all__ if id(getattr(gs, name)) not in described] == []
    lacking = []
    for whole in PAGES:
        for name, one in documented(whole).items():
            # Its own, or the class's, where that calls it.
            called = f".{name.rpartition('.')[2]}(" in (named(whole).__doc__ or "")
            if ">>>" not in (one.__doc__ or "") and not called:
                lacking.append(name)
    assert lacking == []


@pytest.fixture(scope="module")
def light() -> gs.Light:
    """Make the light of the example of `Light`, which those of its methods and frames take."""
    camera = gs.Camera.load("mtf-only")
    small = gs.Camera(camera.lens, camera.sensor.roi(48, 64), "small")
    return gs.expose(small, gs.Scene.load("colorchecker"), 1e-2, probes=0)


# With what the classes of the library inherit, and the package itself.
MODULES = {whole.rpartition(".")[0] for whole in PAGES} | {
    "gpusim",
    "gpusim.lens.model",
    "gpusim.lens.prescription",
    "gpusim.sensor.sensor",
}


@pytest.mark.parametrize("module", one_in(3, sorted(MODULES)))
def test_the_examples_in_the_docstrings_run(
    module: str, light: gs.Light, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)  # where examples write
    known = {"light": light, "frame": light.capture(1 / 60, seed=7)}
    found = doctest.testmod(importlib.import_module(module), extraglobs=known)
    assert found.attempted and not found.failed


def test_lens_sensor_camera_and_scene_are_values():
    lens = gs.Lens.load("tessar").scaled(10.0).stopped(8.0)
    camera = gs.Camera(lens, gs.Sensor.load("imx477").roi(100, 120))
    assert camera.title == f"{lens.title}, IMX477-like"
    again = pickle.loads(pickle.dumps(camera))
    assert again == camera and again.lens.history == lens.history
    scene = gs.Scene.from_rgb(np.full((6, 8, 3), 0.5))
    lines = np.array([450.0, 550.0])
    for given in (scene, gs.Scene.load("colorchecker")):
        back = pickle.loads(pickle.dumps(given))
        for one, other in zip(given.light(lines), back.light(lines), strict=True):
            assert (one == other).all()
    with pytest.raises(AttributeError):
        camera.lens = lens
    with pytest.raises(AttributeError):
        scene.name = "other"


@pytest.mark.parametrize(
    "changes, field",
    [
        ({"focal_lenght_mm": 50.0}, "focal_lenght_mm"),
        ({"max_field_deg": -3.0}, "max_field_deg"),
        ({"surfaces": "none"}, "surfaces"),
    ],
)
def test_a_lens_of_fields_tells_what_is_wrong(changes: dict, field: str):
    fields = gs.Lens.load("tessar").model_dump()
    assert gs.Lens(**fields).title == fields["title"]
    with pytest.raises(UserError) as error:
        gs.Lens(**(fields | changes))
    assert error.value.field == field and error.value.allowed and error.value.file is None
    with pytest.raises(UserError, match="fields are missing"):
        gs.Lens()


def test_a_name_is_no_lens_and_no_sensor():
    sensor = gs.Sensor.load("imx477")
    with pytest.raises(UserError, match=r"gs.Lens.load\('tessar'\)"):
        gs.Camera("tessar", sensor)
    with pytest.raises(UserError, match=r"gs.Sensor.load\('imx477'\)"):
        gs.Camera(gs.Lens.load("tessar"), "imx477")


def test_a_shifted_filter_array_acts_however_the_sensor_is_made(tmp_path: Path):
    fields = load_sensor("imx477").model_dump()
    fields["cfa"]["shift_px"] = (0.3, 0.1)
    fields["fill_factor"] = 0.9
    made = gs.Sensor(**fields)
    assert len(made.channels) > 3 and not any(made.cfa.shift_px)
    assert gs.Sensor.model_validate_json(made.model_dump_json()) == made


def test_masks_act_however_the_sensor_is_made(tmp_path: Path):
    np.save(tmp_path / "gain.npy", np.full((4, 6), 0.5, np.float32))
    fields = load_sensor("imx477").roi(4, 6).model_dump() | {"first_row": 0, "first_col": 0}
    fields["masks"] = Masks(gain=str(tmp_path / "gain.npy"))
    made = gs.Sensor(**fields)
    assert (
        made.masks.area == (0, 0, 4, 6) and (made.masks.part("gain", (0, 0), (4, 6)) == 0.5).all()
    )
    fields["rows"] = 5
    with pytest.raises(UserError, match="not of the sensor's size"):
        gs.Sensor(**fields)


@pytest.mark.parametrize(
    "rgb, field",
    [
        (np.zeros((4, 4)), "rgb"),
        (np.full((4, 4, 3), np.nan), "rgb"),
        (-np.ones((4, 4, 3)), "rgb"),
        ("text", "rgb"),
        (np.zeros((0, 4, 3)), "rgb"),
        (np.zeros((4, 4, 3), np.uint8), "rgb"),  # encoded, not light
    ],
)
def test_arrays_that_are_no_picture_are_refused(rgb: object, field: str):
    with pytest.raises(UserError) as error:
        gs.Scene.from_rgb(rgb)
    assert error.value.field == field


def test_a_spectral_array_is_linear_between_its_bands():
    cube = np.zeros((4, 5, 3))
    cube[..., 1] = 2.0
    scene = gs.Scene.from_spectra(cube, [450.0, 550.0, 650.0])
    shown = np.einsum("brc,bk->krc", scene.source.planes, scene.spectra)[:, 0, 0]
    lines = scene.wavelengths_nm
    # Planes are float32.
    assert shown == pytest.approx(np.interp(lines, [450, 550, 650], [0, 2, 0]), abs=1e-6)
    assert "450 to 650 nm" in scene.notes[0]
    with pytest.raises(UserError, match="do not rise"):
        gs.Scene.from_spectra(cube, [450.0, 450.0, 650.0])
    with pytest.raises(UserError, match="no band lies"):
        gs.Scene.from_spectra(cube, [1450.0, 1550.0, 1650.0])


@pytest.mark.parametrize("name", ["x" * 300, "a\0b"])
@pytest.mark.parametrize(
    "kind, suffix",
    [
        *(("Lens", suffix) for suffix in ("", ".zmx", ".nc", ".txt", ".yaml")),
        *(("Scene", suffix) for suffix in ("", ".exr", ".png", ".hdr", ".mat", ".dng", ".yaml")),
        *(("Camera", suffix) for suffix in ("", ".yaml")),
        *(("Sensor", suffix) for suffix in ("", ".yaml", ".mat", ".json")),
        ("Light", ".npz"),
        ("Sweep", ".yaml"),
    ],
)
def test_a_name_that_can_be_no_files_is_one_clear_error(kind: str, suffix: str, name: str):
    with pytest.raises(gs.UserError):
        getattr(gs, kind).load(name + suffix)
