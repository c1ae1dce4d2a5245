"""Raw files developed by our own stages on the GPU."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from gpusim.errors import UserError
from gpusim.gpu import Device, default_device
from gpusim.isp.pipeline import Developed, develop_source
from gpusim.isp.quad import PERIOD, quad_phase, write_bayer
from gpusim.isp.rawfile import RAW_FILES, read_raw
from gpusim.isp.settings import Settings
from gpusim.isp.source import Source, like, read_source

PLAIN = Settings()


def develop(
    path: Path,
    settings: Settings = PLAIN,
    *,
    device: Device | None = None,
    binned: bool = False,
    bits: int = 8,
    progress: Callable[[int, int], None] | None = None,
) -> Developed:
    """Develop a raw file: ours, or one that LibRaw can read.

    By default nothing is automatic: a picture is as bright as its exposure made it, and white is
    where the first channel saturates. A sensor with fewer than three colours gives a grey one.

    Parameters
    ----------
    path : Path
    settings : Settings
    device : Device, optional
    binned : bool
        Whether a quad Bayer frame gets one pixel for each cell of 2 x 2; else all, remosaiced.
    bits : int
        Bits of each colour of the picture: 8 or 16.
    progress : callable, optional
        Called with (bands done, bands in all).

    Raises
    ------
    UserError
        The file is missing or cannot be read, there is nothing to bin, or the settings do not fit.
    """
    if not os.path.isfile(path):
        raise UserError("no such raw file", file=path, allowed=RAW_FILES)
    source = _read(path, binned=binned)
    if settings.like is not None:
        source = _like(source, Path(settings.like))
    try:
        return develop_source(source, settings, device or default_device(), bits, progress)
    except UserError as error:
        error.file = error.file or path
        raise


def _like(source: Source, path: Path) -> Source:
    if not os.path.isfile(path):
        raise UserError("no such raw file", file=path, field="--like", allowed=RAW_FILES)
    try:
        return like(source, _read(path, binned=False))
    except ValueError as error:
        raise UserError(
            f"the other camera's file does not fit: {error}",
            file=path,
            field="--like",
            allowed="a raw file with filters of the same colours",
        ) from None


def _read(path: Path, *, binned: bool) -> Source:
    import rawpy

    try:
        source = read_source(path)
        is_quad = quad_phase(source.pattern) is not None
        if binned and not is_quad:
            raise UserError("there is nothing to bin: no quad Bayer", file=path, field="--binned")
        raw = read_raw(path) if is_quad else None
        if raw is None or min(source.codes.shape) < 2 * PERIOD:
            return source
        with tempfile.TemporaryDirectory() as folder:
            bayer = Path(folder) / "bayer.dng"
            write_bayer(raw, bayer, binned=binned)
            return read_source(bayer)
    except (ValueError, LookupError, rawpy.LibRawError) as error:
        message = error.args[0] if error.args else ""
        text = message.decode(errors="replace") if isinstance(message, bytes) else str(message)
        raise UserError(
            "this raw file cannot be developed",
            file=path,
            value=text,
            allowed="a raw file with a filter array, such as DNG; --engine libraw reads more",
        ) from None
