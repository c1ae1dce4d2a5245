"""Camera image-chain simulator: from spectral radiance to the raw numbers a camera would write.

>>> import gpusim as gs
>>> camera = gs.Camera(gs.Lens.load("double-gauss"), gs.Sensor.load("imx477").roi(480, 640))
>>> camera.sensor
Sensor('IMX477-like', 640 x 480 pixels of 1.55 um, 12 bit, full well 8180 e-)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:
    from gpusim.batch.dataset import Dataset
    from gpusim.batch.sweep import Sweep
    from gpusim.errors import UserError
    from gpusim.library.burst import Burst
    from gpusim.library.camera import Camera
    from gpusim.library.expose import expose
    from gpusim.library.frame import Frame
    from gpusim.library.irradiance import Irradiance
    from gpusim.library.lens import Lens
    from gpusim.library.light import Light
    from gpusim.library.scene import Scene
    from gpusim.library.sensor import Sensor
    from gpusim.library.session import Session
    from gpusim.preview.window import widget

# Where each public name lives: it is imported when it is first asked for, so that `import gpusim`
# takes milliseconds.
_HOMES = {
    "Burst": "gpusim.library.burst",
    "Camera": "gpusim.library.camera",
    "Dataset": "gpusim.batch.dataset",
    "Frame": "gpusim.library.frame",
    "Irradiance": "gpusim.library.irradiance",
    "Lens": "gpusim.library.lens",
    "Light": "gpusim.library.light",
    "Scene": "gpusim.library.scene",
    "Sensor": "gpusim.library.sensor",
    "Session": "gpusim.library.session",
    "Sweep": "gpusim.batch.sweep",
    "UserError": "gpusim.errors",
    "expose": "gpusim.library.expose",
    "widget": "gpusim.preview.window",
}
__all__ = [
    "Burst",
    "Camera",
    "Dataset",
    "Frame",
    "Irradiance",
    "Lens",
    "Light",
    "Scene",
    "Sensor",
    "Session",
    "Sweep",
    "UserError",
    "expose",
    "widget",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'gpusim' has no attribute {name!r}")
    found = getattr(import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
