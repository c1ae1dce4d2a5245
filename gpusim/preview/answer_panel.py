"""The panel of answers beside the preview's picture: histogram, edge, PSF, time and work."""

from __future__ import annotations

import numpy as np
from imgui_bundle import imgui

from gpusim.gpu.screen import Textures
from gpusim.preview import answers
from gpusim.preview.controls import Controls
from gpusim.preview.engine import Engine, Shown
from gpusim.preview.memory import Memory
from gpusim.preview.state import Knobs

SOFT = imgui.ImVec4(0.62, 0.66, 0.72, 1.0)
WARN = imgui.ImVec4(1.0, 0.62, 0.30, 1.0)


class AnswerPanel:
    """Draws what a picture says.

    Parameters
    ----------
    textures : Textures
    memory : Memory
    engine : Engine
        Has the PSFs.
    controls : Controls
        Has the sensor.
    """

    def __init__(
        self, textures: Textures, memory: Memory, engine: Engine, controls: Controls
    ) -> None:
        self.textures, self.memory = textures, memory
        self.engine, self.controls = engine, controls

    def draw(
        self,
        shown: Shown | None,
        knobs: Knobs,
        roi: tuple[int, int, int, int] | None,
        loupe: tuple[float, float] | None,
    ) -> None:
        """Draw the answers of a picture: of its edge in a region, and of the PSF at a place."""
        if shown is None:
            imgui.text_colored(SOFT, "no picture yet")
            return
        self._histogram(shown)
        self._edge(shown, roi)
        self._psf(knobs, loupe)
        self._account(shown)

    def _histogram(self, shown: Shown) -> None:
        imgui.separator_text("raw histogram")
        found = self.memory.of("histogram", shown, lambda: answers.histogram(shown.frame))
        curves = {
            name: (curve, answers.COLOURS.get(name, answers.GREY))
            for name, curve in found.curves.items()
        }
        _plot(curves, 84.0)
        clipped = "  ".join(f"{name} {one:.2%}" for name, one in found.saturated.items())
        imgui.text_colored(SOFT, f"saturated: {clipped}")
        seconds, iso = shown.frame.exposure_s, shown.frame.iso
        imgui.text_colored(SOFT, f"{seconds:.4g} s, ISO {iso}")

    def _edge(self, shown: Shown, roi: tuple[int, int, int, int] | None) -> None:
        imgui.separator_text("edge (Shift-drag a region)")
        if roi is None:
            return
        found = self.memory.of("edge", (shown, roi), lambda: answers.edge(shown, roi))
        if isinstance(found, str):
            imgui.push_style_color(imgui.Col_.text, WARN)
            imgui.text_wrapped(found)
            imgui.pop_style_color()
            return
        keep = found.frequency_cy_px <= 1
        _plot({"SFR": (np.clip(found.sfr[keep], 0, 1.2) / 1.2, answers.GREY)}, 84.0)
        fall = found.falls_to(0.5)
        half = "none" if fall is None else f"{fall.value:.3f} c/px"
        imgui.text(f"MTF50 {half}, Nyquist {found.at(0.5).value:.3f}")
        imgui.text_colored(SOFT, f"0 to 1 c/px, edge {abs(found.line.angle_deg):.2f} deg")

    def _psf(self, knobs: Knobs, loupe: tuple[float, float] | None) -> None:
        imgui.separator_text("PSF (right click)")
        if loupe is None:
            return
        psf, pitch_um = self.engine.psf(knobs, *loupe)
        n = len(psf)
        near = self.memory.of(
            "psf", (psf,), lambda: _toned(psf[n // 4 : -n // 4, n // 4 : -n // 4])
        )
        imgui.image(self.textures.of("psf", near), (112, 112))
        imgui.same_line()
        imgui.begin_group()
        pixel_um = self.controls.sensor(knobs).pixel_pitch_um
        _, curves = self.memory.of(
            "mtf", (psf, pixel_um), lambda: answers.mtf(psf, pitch_um, pixel_um)
        )
        _plot(
            {
                "radial": (curves[0], (0.47, 0.78, 1.0)),
                "tangential": (curves[1], (1.0, 0.72, 0.35)),
            },
            84.0,
        )
        imgui.text_colored(SOFT, "MTF to 1 c/px")
        imgui.end_group()

    def _account(self, shown: Shown) -> None:
        imgui.separator_text("time and work")
        for name, seconds in shown.times_s.items():
            imgui.text(f"{name:12} {1e3 * seconds:8.0f} ms")
        if imgui.collapsing_header("left out"):
            for name, reason in answers.left_out(shown.plan):
                imgui.text(name)
                imgui.push_style_color(imgui.Col_.text, SOFT)
                imgui.text_wrapped(reason)
                imgui.pop_style_color()


def _toned(psf: np.ndarray) -> np.ndarray:
    """Return a PSF as a picture: fourth root, so that faint light is seen."""
    light = (psf / (psf.max() or 1.0)).clip(0, 1) ** 0.25
    return np.repeat(np.round(255 * light).astype(np.uint8)[..., None], 3, axis=2)


def _plot(curves: dict[str, tuple[np.ndarray, tuple[float, float, float]]], height: float) -> None:
    """Draw curves from 0 to 1 over the panel's width."""
    width = imgui.get_content_region_avail().x
    left, top = imgui.get_cursor_screen_pos()
    draw = imgui.get_window_draw_list()
    draw.add_rect_filled((left, top), (left + width, top + height), imgui.IM_COL32(24, 27, 32, 255))
    for part in (0.25, 0.5, 0.75):
        draw.add_line(
            (left + part * width, top), (left + part * width, top + height),
            imgui.IM_COL32(60, 66, 74, 255),
        )  # fmt: skip
    for values, colour in curves.values():
        x = left + np.linspace(0, width, len(values))
        y = top + height - 2 - (height - 4) * np.clip(values, 0, 1)
        paint = imgui.IM_COL32(*(int(255 * one) for one in colour), 255)
        points = [imgui.ImVec2(float(a), float(b)) for a, b in zip(x, y, strict=True)]
        draw.add_polyline(points, paint, 1.4, 0)
    imgui.dummy((width, height))
    if len(curves) > 1:
        for name, (_, colour) in curves.items():
            imgui.text_colored(imgui.ImVec4(*colour, 1.0), name)
            imgui.same_line()
        imgui.new_line()
