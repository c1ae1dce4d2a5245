"""Radiance pictures (.hdr, .pic): four bytes a pixel, three mantissas and an exponent.

Ward, "Real pixels" (Graphics Gems II, 1991), and the Radiance file formats (filefmts.pdf).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from gpusim.config.text import read_bytes
from gpusim.errors import UserError
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, rgb_to_xyz
from gpusim.scene.exr import MOST_PIXELS, Photograph, _into_gamut

# Luminous efficacy of white light by Radiance's own convention, lm/W: of RGB (1, 1, 1).
EFFICACY_LM_PER_W = 179.0
SIZE = re.compile(rb"([-+])([XY]) +(\d{1,6}) +([-+])([XY]) +(\d{1,6})")
LEAST, MOST = 8, 0x7FFF  # samples of a line that may be packed by component
HEADER_BYTES = 1 << 16


def read_hdr(path: Path) -> Photograph:
    """Read a Radiance picture.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Photograph
        Divided by the header's exposures. Its white has 179 cd/m^2, as Radiance has it.

    Raises
    ------
    UserError
        Where it is no such picture, too large, or ends early.
    """
    content = read_bytes(path, "the picture")
    lines, at = _lines(content, path)
    end = content.find(b"\n", at, HEADER_BYTES)
    size = SIZE.fullmatch(content[at : max(end, at)].strip())
    if size is None or {size[2], size[5]} != {b"X", b"Y"}:
        raise _broken(path, "no line says its size, as -Y 480 +X 640")
    down, across = int(size[3]), int(size[6])
    if not 0 < down * across <= MOST_PIXELS:
        raise UserError(
            "a picture of a size that is not read", file=path, value=f"{across} x {down}",
            allowed=f"1 to {MOST_PIXELS:,} pixels",
        )  # fmt: skip
    kind, exposure, primaries = _header(lines, path)
    pixels = _unpacked(content, end + 1, down, across, path)
    # (mantissa + 1/2) 2^(exponent - 136); exponent 0 is black.
    factor = np.ldexp(1.0, pixels[..., 3].astype(np.int32) - 136)
    factor[pixels[..., 3] == 0] = 0.0
    rgb = np.moveaxis((pixels[..., :3] + 0.5) * factor[..., None] / exposure, -1, 0)
    rgb = _upright(rgb, size[1] + size[2], size[4] + size[5])
    notes = [f"white taken as {EFFICACY_LM_PER_W:g} cd/m^2, as Radiance has RGB (1, 1, 1)"]
    own = np.eye(3)
    space = rgb_to_xyz(REC709_CHROMATICITIES)
    if kind == b"32-bit_rle_xyze":
        rgb = np.einsum("ij,jrc->irc", np.linalg.inv(space), rgb)
    elif primaries is not None:
        own = np.linalg.solve(space, rgb_to_xyz(primaries))
        rgb = np.einsum("ij,jrc->irc", own, rgb)
        notes.append("converted from the file's primaries to Rec.709")
    rgb, moved = _into_gamut(rgb, space[1])
    if moved:
        notes.append(f"{moved} pixels outside Rec.709 moved to its boundary, luminance kept")
    white = tuple(own @ np.ones(3))
    return Photograph(rgb.astype(np.float32), white, EFFICACY_LM_PER_W, tuple(notes))


def _lines(content: bytes, path: Path) -> tuple[list[bytes], int]:
    """Return the lines of the header, and where the line of the size begins."""
    lines, at = [], 0
    while True:
        end = content.find(b"\n", at, HEADER_BYTES)
        if end < 0:
            raise _broken(path, "its header does not end")
        lines.append(content[at:end].strip())
        at = end + 1
        if lines[-1] == b"":
            break
    if not lines[0].startswith(b"#?"):
        raise _broken(path, "it does not begin with #?")
    return lines, at


def _upright(rgb: np.ndarray, first: bytes, second: bytes) -> np.ndarray:
    """Return planes mirrored and turned until row 0 is up and column 0 left.

    They are stored from the start of the axes, which are named by sign and letter.
    """
    if first in (b"+Y", b"-X"):
        rgb = rgb[:, ::-1]
    if second in (b"-X", b"+Y"):
        rgb = rgb[:, :, ::-1]
    return rgb.transpose(0, 2, 1) if first[1:] == b"X" else rgb


def _header(lines: list[bytes], path: Path) -> tuple[bytes, float, tuple[float, ...] | None]:
    """Return the format, the product of all exposures, and the primaries if they are given."""
    kind, exposure, primaries = b"32-bit_rle_rgbe", 1.0, None
    for line in lines:
        name, _, value = line.partition(b"=")
        try:
            if name == b"FORMAT":
                kind = value.strip()
            elif name == b"EXPOSURE":
                exposure *= float(value)
            elif name == b"PRIMARIES":
                primaries = tuple(float(one) for one in value.split())
                rgb_to_xyz(primaries)
        except (ValueError, TypeError, OverflowError):
            raise _broken(path, f"{name.decode()} is wrong", value) from None
    if kind not in (b"32-bit_rle_rgbe", b"32-bit_rle_xyze"):
        raise _broken(path, "FORMAT is wrong", kind)
    if not 1e-30 < exposure < 1e30:
        raise _broken(path, "EXPOSURE is wrong", f"{exposure:g}".encode())
    return kind, exposure, primaries


def _unpacked(content: bytes, at: int, rows: int, cols: int, path: Path) -> np.ndarray:
    """Return the four bytes of each pixel (rows, cols, 4), uint8."""
    out = np.zeros((rows, cols, 4), np.uint8)
    data = np.frombuffer(content, np.uint8)
    for row in range(rows):
        start = content[at : at + 4]
        if len(start) < 4:
            raise _broken(path, f"it ends at row {row} of {rows}")
        if not (LEAST <= cols <= MOST and start[:2] == b"\x02\x02" and start[2] < 128):
            at = _by_pixel(data, at, out[row], path)
            continue
        if start[2] << 8 | start[3] != cols:
            raise _broken(path, f"row {row} is not of {cols} pixels")
        at += 4
        for component in range(4):
            at = _by_runs(content, data, at, out[row, :, component], path)
    return out


def _by_runs(content: bytes, data: np.ndarray, at: int, line: np.ndarray, path: Path) -> int:
    """Fill one component of a line from runs and copies; return where they end."""
    done, count = 0, len(line)
    while done < count:
        if at + 1 >= len(content):
            raise _broken(path, "it ends within a line")
        length = content[at]
        if length > 128:
            length -= 128
            if done + length > count:
                raise _broken(path, "a run goes on beyond its line")
            line[done : done + length] = content[at + 1]
            at += 2
        else:
            part = data[at + 1 : at + 1 + length]
            if not 0 < length <= count - done or len(part) < length:
                raise _broken(path, "a line is packed wrongly")
            line[done : done + length] = part
            at += 1 + length
        done += length
    return at


def _by_pixel(data: np.ndarray, at: int, line: np.ndarray, path: Path) -> int:
    """Fill a line of whole pixels, of which 1, 1, 1, n repeats the last; return where they end."""
    flat = data[at : at + 4 * len(line)]
    if flat.size == line.size and not (flat.reshape(-1, 4)[:, :3] == 1).all(axis=1).any():
        line[:] = flat.reshape(-1, 4)
        return at + line.size
    done, shift = 0, 0
    while done < len(line):
        pixel = data[at : at + 4]
        if len(pixel) < 4:
            raise _broken(path, "it ends within a line")
        at += 4
        if tuple(pixel[:3]) == (1, 1, 1):
            length = int(pixel[3]) << shift
            if not (0 < done and done + length <= len(line) and shift < 24):
                raise _broken(path, "a run goes on beyond its line, or has nothing before it")
            line[done : done + length] = line[done - 1]
            done, shift = done + length, shift + 8
        else:
            line[done] = pixel
            done, shift = done + 1, 0
    return at


def _broken(path: Path, reason: str, value: bytes | None = None) -> UserError:
    shown = None if value is None else value.decode("utf-8", "replace")
    return UserError(
        f"no Radiance picture that can be read: {reason}",
        file=path,
        value=shown,
        allowed="#?RADIANCE, FORMAT=32-bit_rle_rgbe or 32-bit_rle_xyze",
    )
