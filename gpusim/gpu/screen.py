"""What a screen of panels is drawn with: a device of its own, Dear ImGui, and its pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .adapters import runtime_dir

if TYPE_CHECKING:
    import wgpu


def drawing_on(canvas: Any) -> tuple[Any, Textures]:
    """Return what draws Dear ImGui on a canvas of rendercanvas, and its pictures.

    It has a device of its own: drawing does not wait for work on others.
    """
    import wgpu
    from wgpu.utils.imgui import ImguiRenderer

    with runtime_dir():
        device = wgpu.gpu.request_adapter_sync().request_device_sync()
    drawing = ImguiRenderer(device, canvas)
    return drawing, Textures(device, drawing.backend)


class Textures:
    """Pictures by name; a name's picture is sent anew when it is another array.

    Parameters
    ----------
    device : wgpu.GPUDevice
    backend
        Dear ImGui's: it draws them.
    """

    def __init__(self, device: wgpu.GPUDevice, backend: Any) -> None:
        self._device, self._backend = device, backend
        self._held: dict[str, tuple[np.ndarray, Any, Any, Any]] = {}

    def of(self, name: str, rgb: np.ndarray) -> Any:
        """Return what ImGui draws for a picture (rows, cols, 3), uint8."""
        held = self._held.get(name)
        if held is not None and held[0] is rgb:
            return held[3]
        rows, cols = rgb.shape[:2]
        if held is None or held[0].shape != rgb.shape:
            if held is not None:
                self._backend.unregister_texture(held[3])
            texture = self._device.create_texture(
                size=(cols, rows, 1),
                format="rgba8unorm",
                usage="COPY_DST | TEXTURE_BINDING",
            )
            view = texture.create_view()
            held = (rgb, texture, view, self._backend.register_texture(view))
        pixels = np.full((rows, cols, 4), 255, np.uint8)
        pixels[..., :3] = rgb
        self._device.queue.write_texture(
            {"texture": held[1]},
            pixels,
            {"bytes_per_row": 4 * cols, "rows_per_image": rows},
            (cols, rows, 1),
        )
        self._held[name] = (rgb, *held[1:])
        return held[3]
