"""The GPU layer: the only place that knows wgpu, which it loads with the first device."""

from .adapters import devices
from .arrays import Array, Resident
from .compiling import Compiled, compiling
from .device import Device, DeviceLostError, default_device
from .exact import double_float
from .kernel import Kernel
from .packing import ShaderError
from .pool import OutOfMemoryError, Use
from .recording import Recording, Result
from .wgsl import held

__all__ = [
    "Array",
    "Compiled",
    "Device",
    "DeviceLostError",
    "Kernel",
    "OutOfMemoryError",
    "Recording",
    "Resident",
    "Result",
    "ShaderError",
    "Use",
    "compiling",
    "default_device",
    "devices",
    "double_float",
    "held",
]
