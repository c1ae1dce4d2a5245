"""A compute kernel: one shader file with its overrides, checked and compiled once."""

from __future__ import annotations

import os
import re
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from . import wgsl
from .arrays import DTYPES, Array
from .device import PORTABLE_LIMITS, Device
from .packing import SCALARS, ShaderError
from .pool import Use
from .recording import Recording

if TYPE_CHECKING:
    import wgpu


@dataclass(frozen=True)
class Pipeline:
    """What a device keeps of a compiled kernel."""

    pipeline: wgpu.GPUComputePipeline
    layout: wgpu.GPUBindGroupLayout


class Kernel:
    """The shader ``path`` (below the shaders root, without suffix) with its overrides.

    Nothing is compiled until the kernel is first recorded on a device; the device then keeps the
    pipeline under the composed text and the overrides, so making a Kernel again is cheap.

    Attributes
    ----------
    path : str
        The stage name.
    overrides : dict
        Every override with its resolved value.
    workgroup_size : (int, int, int)
    workgroup_bytes : int
    params : Struct
        Memory layout of ``struct Params``; ``params.dtype`` and ``params.pack(values)``.
    buffers : dict of str to Binding
        The bindings after ``params``, by name.
    key : tuple
        The composed text's digest and the overrides that were given: kernels of one key are one.

    Raises
    ------
    ShaderError
        No such shader; an unknown override or a value of the wrong type; more workgroup storage,
        invocations, storage buffers or textures than every adapter has.
    """

    def __init__(self, path: str, **overrides: bool | int | float) -> None:
        made = wgsl.kept((path, *sorted(overrides.items())))
        if "key" not in made:
            self._prepare(wgsl.load(path), overrides)
            made.update(self.__dict__)
        self.__dict__.update(made)

    @classmethod
    def from_text(cls, name: str, text: str, **overrides: bool | int | float) -> Kernel:
        """Make a kernel of a text that is no file; it may include files of ``common/``."""
        kernel = cls.__new__(cls)
        kernel._prepare(wgsl.compose(name, text), overrides)
        return kernel

    def _prepare(self, source: wgsl.Source, overrides: Mapping[str, bool | int | float]) -> None:
        self.path = source.name
        self.source = source
        try:
            self.module = module = wgsl.reflect(source.text)
            unknown = overrides.keys() - module.overrides.keys()
            if unknown:
                raise ShaderError(
                    f"unknown override {sorted(unknown)}, declared are {sorted(module.overrides)}"
                )
            self._given = {
                name: _override(module.overrides[name], value) for name, value in overrides.items()
            }
            names = module.constants(self._given)
            self.overrides = {name: names.evaluate(name) for name in module.overrides}
            self.workgroup_size = module.workgroup_size(names)
            self.workgroup_bytes = module.workgroup_bytes(names)
            rules = module.layouts(names)
            self._types = {
                one.name: rules.of("array<vec4f>" if one.kind == "texels" else one.type)
                for one in module.bindings
            }
        except ShaderError as error:
            raise ShaderError(f"{self.path}: {error}") from error
        self.params = module.params
        self.buffers = {one.name: one for one in module.bindings[1:]}
        self.key = (source.digest, tuple(sorted(self._given.items())))
        self._refuse()

    def _refuse(self) -> None:
        """Refuse what wgpu lets pass and adapters then get wrong (gfx-rs/wgpu #8946, #7429)."""
        x, y, z = self.workgroup_size
        sides = [PORTABLE_LIMITS[f"max-compute-workgroup-size-{axis}"] for axis in "xyz"]
        kinds = Counter(one.kind for one in self.module.bindings)
        for what, found, limit in (
            ("bytes of workgroup storage", self.workgroup_bytes, 16384),
            ("invocations per workgroup", x * y * z, 256),
            ("storage buffers", kinds["storage"] + kinds["read-only-storage"], 8),
            ("textures", kinds["texels"], 16),
            *zip(
                ("workgroup width", "workgroup height", "workgroup depth"),
                (x, y, z),
                sides,
                strict=True,
            ),
        ):
            if found > limit:
                raise ShaderError(f"{self.path}: {found} {what}, every adapter has only {limit}")
        if min(x, y, z) < 1:
            raise ShaderError(f"{self.path}: workgroup size {self.workgroup_size}")

    def cover(self, nx: int, ny: int = 1, nz: int = 1) -> tuple[int, int, int]:
        """Return the number of workgroups that gives at least (nx, ny, nz) invocations."""
        x, y, z = self.workgroup_size
        return -(-nx // x), -(-ny // y), -(-nz // z)

    def record(
        self,
        rec: Recording,
        groups: tuple[int, int, int],
        params: Mapping[str, object],
        **buffers: Array,
    ) -> None:
        """Append one dispatch to a recording; nothing runs yet.

        Parameters
        ----------
        rec : Recording
        groups : (int, int, int)
            Workgroups; where one is zero the dispatch is left out.
        params : dict
            A value for each member of ``struct Params``.
        **buffers : Array
            A proxy of the recording or a resident for each binding, by its name in the shader.

        Raises
        ------
        ShaderError
            A name that is missing, unknown or of the wrong kind; more than 65535 workgroups along
            one axis; one buffer bound twice where a binding writes.
        """
        try:
            data = self.params.pack(params)
            self._check_groups(groups)
            self._check_buffers(buffers)
        except ShaderError as error:
            raise ShaderError(f"{self.path}: {error}") from error
        rec.dispatch(self, tuple(int(count) for count in groups), data, buffers)

    def _check_groups(self, groups: tuple[int, int, int]) -> None:
        limit = PORTABLE_LIMITS["max-compute-workgroups-per-dimension"]
        if len(groups) != 3 or not all(0 <= count <= limit for count in groups):
            raise ShaderError(f"groups {groups}: three numbers from 0 to {limit} are needed")

    def _check_buffers(self, buffers: Mapping[str, Array]) -> None:
        missing, extra = self.buffers.keys() - buffers.keys(), buffers.keys() - self.buffers
        if missing or extra:
            raise ShaderError(f"buffers missing {sorted(missing)}, unknown {sorted(extra)}")
        for name, array in buffers.items():
            kind = self._types[name]
            if (array.use is Use.TEXELS) != (self.buffers[name].kind == "texels"):
                raise ShaderError(f"{name}: {self.buffers[name].kind} is declared, got {array.use}")
            if kind.scalar is not None and DTYPES[array.dtype] != kind.scalar:
                declared = self.buffers[name].type
                raise ShaderError(f"{name}: array<{declared}> is declared, got {array}")
            step = kind.stride or kind.size
            if array.nbytes % step or array.nbytes < kind.size:
                raise ShaderError(f"{name}: {array} has {array.nbytes} bytes, elements have {step}")
        seen: dict[int, str] = {}
        for name, array in buffers.items():
            other = seen.setdefault(id(array), name)
            if other != name and "storage" in (self.buffers[name].kind, self.buffers[other].kind):
                raise ShaderError(
                    f"{other} and {name} are the same buffer {array.label!r}, and one is written"
                )

    def least_bytes(self, name: str) -> int:
        """Return the fewest bytes that the binding ``name`` takes; of an open one, an element."""
        return max(self._types[name].size, self._types[name].stride)

    def writes(self, name: str) -> bool:
        """Return whether the binding ``name`` is read_write."""
        return self.buffers[name].kind == "storage"

    def compile(self, device: Device) -> Pipeline:
        """Return the compiled kernel; the device keeps it.

        Raises
        ------
        ShaderError
            The shader does not compile: with the lines around the error and their origins.
        """
        if self.key not in device.pipelines:
            device.pipelines[self.key] = self._compile(device.gpu)
        return device.pipelines[self.key]

    def _compile(self, gpu: wgpu.GPUDevice) -> Pipeline:
        import wgpu

        if os.environ.get("GPUSIM_PRINT_WGSL") == "1":
            print(f"{self.path} {self._given}\n{self.source.numbered()}", file=sys.stderr)
        layout = gpu.create_bind_group_layout(
            label=self.path,
            entries=[
                {
                    "binding": one.index,
                    "visibility": wgpu.ShaderStage.COMPUTE,
                    **_resource(one),
                }
                for one in self.module.bindings
            ],
        )
        try:
            pipeline = gpu.create_compute_pipeline(
                label=self.path,
                layout=gpu.create_pipeline_layout(label=self.path, bind_group_layouts=[layout]),
                compute={
                    "module": gpu.create_shader_module(label=self.path, code=self.source.text),
                    "entry_point": "main",
                    "constants": self._given,
                },
            )
        except wgpu.GPUError as error:
            raise ShaderError(self._explained(str(error))) from error
        return Pipeline(pipeline, layout)

    def _explained(self, message: str) -> str:
        found = re.search(r"wgsl:(\d+):\d+", message)
        shown = self.source.numbered(int(found[1]) if found else None)
        return f"{self.path} does not compile\n{message}\n{shown}"


def _resource(binding: wgsl.Binding) -> dict[str, object]:
    """Return a bind group layout's entry for a binding."""
    if binding.kind == "texels":
        return {"texture": {"sample_type": "unfilterable-float"}}
    return {"buffer": {"type": binding.kind, "has_dynamic_offset": binding.index == 0}}


def _override(declared: wgsl.Override, value: object) -> bool | int | float:
    """Return the value as the Python type that wgpu takes: a NumPy scalar asserts inside it."""
    wrong = f"override {declared.name}: {declared.type} is declared, got {value!r}"
    if isinstance(value, np.generic):
        value = value.item()
    if declared.type == "bool" or isinstance(value, bool):
        if declared.type != "bool" or not isinstance(value, bool):
            raise ShaderError(wrong)
        return value
    if declared.type == "f32" and isinstance(value, int | float) and np.isfinite(value):
        return float(value)
    if declared.type != "f32" and isinstance(value, int):
        limits = np.iinfo(SCALARS[declared.type])
        if limits.min <= value <= limits.max:
            return value
    raise ShaderError(wrong)
