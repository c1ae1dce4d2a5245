"""A recording as plain data: what another WebGPU program needs to replay it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .arrays import Array, Resident
from .commands import Clear, Dispatch, Download, Upload
from .packing import ShaderError
from .pool import Use
from .recording import Recording


@dataclass(frozen=True, eq=False)
class Exported:
    """A recording as plain data.

    Attributes
    ----------
    buffers : list of int
        Bytes of each.
    steps : list of dict
        ``write``: a buffer and the index of its data; ``clear``; ``read``: a buffer and its label;
        ``run``: the name of a shader, its constants, workgroups, the offset and size of its params,
        and a triple of binding, buffer and kind for each buffer.
    data : list of ndarray
        What is written.
    shaders : dict of str to str
        Texts by name.
    params : bytes
        The uniforms, each at its offset.
    members : dict of str to list of int
        Where each member of the dispatches' params lies in `params`, bytes.
    """

    buffers: list[int] = field(default_factory=list)
    steps: list[dict[str, Any]] = field(default_factory=list)
    data: list[np.ndarray] = field(default_factory=list)
    shaders: dict[str, str] = field(default_factory=dict)
    params: bytes = b""
    members: dict[str, list[int]] = field(default_factory=dict)


def exported(rec: Recording) -> Exported:
    """Return a recording as plain data; arrays that stay on the device are read back.

    Raises
    ------
    ShaderError
        The recording has texels.
    """
    found, numbers = Exported(params=rec.params), {}

    def number(array: Array) -> int:
        if array.use is Use.TEXELS:
            raise ShaderError(f"{array} is of texels: they are not exported")
        if id(array) not in numbers:
            numbers[id(array)] = len(found.buffers)
            found.buffers.append(array.nbytes)
            if isinstance(array, Resident):
                write(array, rec.device.read(array))
        return numbers[id(array)]

    def write(target: Array, values: np.ndarray) -> None:
        found.steps.append({"do": "write", "buffer": number(target), "data": len(found.data)})
        found.data.append(values)

    for command in rec.commands:
        match command:
            case Upload(target, values):
                number(target)
                write(target, values)
            case Clear(target):
                found.steps.append({"do": "clear", "buffer": number(target)})
            case Download(source, _):
                found.steps.append({"do": "read", "buffer": number(source), "label": source.label})
            case Dispatch():
                _dispatch(command, found, number)
            case _:
                raise ShaderError(f"{command} is not exported")
    return found


def _dispatch(command: Dispatch, found: Exported, number: Any) -> None:
    kernel = command.kernel
    found.shaders[kernel.path] = kernel.source.text
    bound = [
        [one.index, number(command.buffers[name]), one.kind] for name, one in kernel.buffers.items()
    ]
    for name, (at, _) in kernel.params.members.items():
        found.members.setdefault(name, []).append(command.offset + at)
    found.steps.append(
        {
            "do": "run",
            "shader": kernel.path,
            "constants": {name: float(value) for name, value in kernel.overrides.items()},
            "groups": list(command.groups),
            "offset": command.offset,
            "size": kernel.params.size,
            "bound": bound,
        }
    )
