"""The left panel: every knob with its unit and range."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from imgui_bundle import imgui

from gpusim import camera as cameras
from gpusim.camera import Camera
from gpusim.formats import lens_file as lenses
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import first_order
from gpusim.preview.state import Knobs, having
from gpusim.scene.charts import CHARTS
from gpusim.sensor import load as sensors
from gpusim.sensor.sensor import Sensor

OWN, OWN_LIGHT = "the camera's own", "the scene's own"
ILLUMINANTS = ("D50", "D55", "D65", "A", "E", "FL2", "5100K")
TOLERANCES = ("1e-1", "1e-2", "1e-3")
LONGEST_S, SHORTEST_S = 4.0, 1e-6
FOCUS_UM = 100.0
LOG = imgui.SliderFlags_.logarithmic
SMALLEST_STOP = 22.0


@lru_cache(maxsize=8)
def bare_camera(knobs: Knobs) -> tuple[Camera, float, list[str]]:
    """Return the camera of `Knobs.bare`, its lens's f-number, and the effects of its sensor."""
    camera = knobs.made_camera()
    lens = camera.lens
    widest = first_order(lens).f_number if isinstance(lens, Prescription) else 1.0
    return camera, widest, having(camera.sensor)


class Controls:
    """Draws the knobs and says which were turned."""

    def __init__(self) -> None:
        self._changes: dict[str, Any] = {}

    def sensor(self, knobs: Knobs) -> Sensor:
        """Return the sensor of knobs, with all its effects."""
        return bare_camera(knobs.bare)[0].sensor

    def draw(self, knobs: Knobs) -> dict[str, Any]:
        """Draw the knobs; return those that were turned, with their values."""
        self._changes = {}
        imgui.push_item_width(150)
        self._read_out(knobs)
        self._lens(knobs)
        self._scene(knobs)
        self._parts(knobs)
        self._effects(knobs)
        imgui.pop_item_width()
        return self._changes

    def _slider(
        self,
        label: str,
        name: str,
        value: float,
        *,
        least: float,
        most: float,
        form: str,
        log: bool = False,
    ) -> None:
        turned, new = imgui.slider_float(label, value, least, most, form, LOG if log else 0)
        if turned:
            self._changes[name] = float(new)

    def _choice(self, label: str, name: str, value: str, names: list[str]) -> None:
        names = names if value in names else [value, *names]
        turned, new = imgui.combo(label, names.index(value), names)
        if turned:
            self._changes[name] = None if names[new] in (OWN, OWN_LIGHT) else names[new]

    def _read_out(self, knobs: Knobs) -> None:
        imgui.separator_text("exposure")
        shown = knobs.exposure_s
        turned, auto = imgui.checkbox("by the scene's white", shown is None)
        if turned:
            self._changes["exposure_s"] = None if auto else 0.01
        if shown is not None:
            self._slider(
                "exposure, s",
                "exposure_s",
                shown,
                least=SHORTEST_S,
                most=LONGEST_S,
                form="%.3g",
                log=True,
            )
        sensor = self.sensor(knobs)
        speeds = sorted({step.iso for step in sensor.analogue_gains or () if step.iso is not None})
        if speeds:
            names = [str(one) for one in speeds]
            now = str(knobs.iso or sensor.iso or names[0])
            names = names if now in names else [now, *names]
            turned, new = imgui.combo("ISO", names.index(now), names)
            if turned:
                self._changes["iso"] = int(names[new])
        celsius = knobs.temperature_c
        celsius = sensor.reference_temperature_c if celsius is None else celsius
        self._slider(
            "temperature, C", "temperature_c", celsius, least=-40.0, most=85.0, form="%.0f"
        )
        turned, noise = imgui.checkbox("noise", knobs.noise)
        if turned:
            self._changes["noise"] = noise
        imgui.same_line()
        if imgui.small_button("new seed"):
            self._changes["seed"] = knobs.seed + 1
        self._slider("shown at, EV", "ev", knobs.ev, least=-6.0, most=6.0, form="%+.1f")

    def _lens(self, knobs: Knobs) -> None:
        camera, widest, _ = bare_camera(knobs.bare)
        lens = camera.lens
        imgui.separator_text("lens")
        if not isinstance(lens, Prescription):
            imgui.text("ready-made: as it is")
            return
        self._slider(
            "focus shift, um", "focus_shift_um", knobs.focus_shift_um or 0.0,
            least=-FOCUS_UM, most=FOCUS_UM, form="%+.1f",
        )  # fmt: skip
        self._slider(
            "f-number",
            "f_number",
            knobs.f_number or widest,
            least=widest,
            most=SMALLEST_STOP,
            form="f/%.2g",
            log=True,
        )
        far = knobs.focus_distance_m or 1000.0
        turned, new = imgui.slider_float("focused on, m", far, 0.1, 1000.0, "%.3g", LOG)
        if turned:
            self._changes["focus_distance_m"] = None if new >= 999.0 else float(new)

    def _scene(self, knobs: Knobs) -> None:
        imgui.separator_text("scene")
        self._choice("scene", "scene", knobs.scene, list(CHARTS))
        self._choice(
            "light", "illuminant", knobs.illuminant or OWN_LIGHT, [OWN_LIGHT, *ILLUMINANTS]
        )
        self._slider(
            "white, cd/m2", "luminance_cd_m2", knobs.luminance_cd_m2 or 300.0,
            least=0.01, most=1e5, form="%.3g", log=True,
        )  # fmt: skip

    def _parts(self, knobs: Knobs) -> None:
        imgui.separator_text("parts")
        turned, new = imgui.combo("camera", *_listed(knobs.camera, cameras.presets()))
        if turned:
            name = _listed(knobs.camera, cameras.presets())[1][new]
            self._changes |= {
                "camera": name, "lens": None, "sensor": None, "iso": None, "f_number": None,
                "focus_shift_um": None, "focus_distance_m": None, "off": frozenset(),
            }  # fmt: skip
        self._choice("lens", "lens", knobs.lens or OWN, [OWN, *sorted(lenses.presets())])
        self._choice("sensor", "sensor", knobs.sensor or OWN, [OWN, *sorted(sensors.presets())])
        if "sensor" in self._changes:
            self._changes |= {"iso": None, "off": frozenset()}
        if "lens" in self._changes:
            self._changes |= {"f_number": None, "focus_shift_um": None}
        self._choice("tolerance", "tolerance", knobs.tolerance, list(TOLERANCES))

    def _effects(self, knobs: Knobs) -> None:
        if not imgui.collapsing_header("effects", imgui.TreeNodeFlags_.default_open):
            return
        for number, name in enumerate(bare_camera(knobs.bare)[2]):
            if number % 2:
                imgui.same_line(128)
            turned, runs = imgui.checkbox(name, name not in knobs.off)
            if turned:
                self._changes["off"] = knobs.off - {name} if runs else knobs.off | {name}


def _listed(value: str, names: list[str]) -> tuple[int, list[str]]:
    names = names if value in names else [value, *names]
    return names.index(value), names
