"""The GPU layer: the only place that knows wgpu."""

from .device import Array, Device, Resident, default_device, devices
from .kernel import Kernel
from .layout import ShaderError
from .recording import Recording, Result

__all__ = [
    "Array",
    "Device",
    "Kernel",
    "Recording",
    "Resident",
    "Result",
    "ShaderError",
    "default_device",
    "devices",
]
