"""The adapters of this machine, and the choice among them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

from gpusim.errors import UserError

from .c_types import parse_few

if TYPE_CHECKING:
    import wgpu

# OpenGL lists the same llvmpipe again and lacks the compute features used here.
_BACKENDS = ("Vulkan", "Metal", "D3D12")
_PREFERENCE = ("DiscreteGPU", "IntegratedGPU", "CPU")


@contextmanager
def runtime_dir() -> Iterator[None]:
    """Name a folder for sockets while adapters are looked for, where the environment names none.

    Mesa asks libwayland for a screen, which complains on stderr of every look without one.
    """
    given = "XDG_RUNTIME_DIR" in os.environ
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())
    try:
        yield
    finally:
        if not given:
            os.environ.pop("XDG_RUNTIME_DIR", None)


@cache
def native() -> Any:
    """Return wgpu's native library, once its types are declared.

    That takes 0.2 s of the processor, which who opens no device need not wait for.
    """
    from wgpu.backends.wgpu_native import ffi, lib

    parse_few(ffi)
    return lib


def usable() -> list[wgpu.GPUAdapter]:
    """Return the adapters that have what is used here."""
    import wgpu

    native()
    with runtime_dir():
        return [
            adapter
            for adapter in wgpu.gpu.enumerate_adapters_sync()
            if adapter.info["backend_type"] in _BACKENDS
        ]


def described(adapter: wgpu.GPUAdapter) -> dict[str, str]:
    """Return adapter, driver, backend and type."""
    info = adapter.info
    return {
        "adapter": info["device"],
        # SwiftShader has an empty text, others do not say more than their vendor.
        "driver": info["description"] or info["vendor"] or "driver of no name",
        "backend": info["backend_type"],
        "type": info["adapter_type"],
    }


def devices() -> list[dict[str, str]]:
    """Return the usable adapters: adapter, driver, backend and type of each."""
    return [described(adapter) for adapter in usable()]


def choose(adapter: str | None) -> wgpu.GPUAdapter:
    """Return the best adapter, or that of a name: see `Device.open`."""
    found = usable()
    if not found:
        raise UserError(
            "No GPU adapter was found (Vulkan, Metal or Direct3D 12)",
            allowed="a GPU driver, or Mesa's software Vulkan driver: "
            "apt-get install libvulkan1 mesa-vulkan-drivers",
        )
    wanted = [
        one
        for one in found
        if adapter is None
        or adapter.lower() in f"{one.info['device']} {one.info['description']}".lower()
    ]
    if not wanted:
        raise UserError(
            "No adapter of that name was found",
            field="adapter",
            value=adapter,
            allowed="part of one of: " + ", ".join(one.info["device"] for one in found),
        )

    def rank(one: wgpu.GPUAdapter) -> int:
        kind = one.info["adapter_type"]
        return _PREFERENCE.index(kind) if kind in _PREFERENCE else len(_PREFERENCE)

    return min(wanted, key=rank)
