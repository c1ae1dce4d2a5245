"""Small pictures of other programs' kinds, written by their formats' own rules."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import OpenEXR
import tifffile
from PIL import Image
from scipy.io import savemat

NM = np.arange(420.0, 701.0, 40.0)
H, C = 6.62607015e-34, 299_792_458.0
AXES = {"bsq": (0, 1, 2), "bil": (1, 0, 2), "bip": (1, 2, 0)}


def cube(bands: int = len(NM), rows: int = 5, cols: int = 7) -> np.ndarray:
    """Return a cube (bands, rows, cols) of which no two samples are alike, from 0.01 up."""
    rng = np.random.default_rng(4)
    return rng.uniform(0.01, 1.0, (bands, rows, cols)).astype(np.float32)


def write_envi(at: Path, values: np.ndarray, interleave: str = "bsq", more: str = "") -> Path:
    """Write a header and its samples; return the header."""
    codes = {"u1": 1, "i2": 2, "i4": 3, "f4": 4, "f8": 5, "u2": 12}
    bands, rows, cols = values.shape
    big = values.dtype.byteorder == ">"
    header = (
        f"ENVI\ndescription = {{made\n up}}\nsamples = {cols}\nlines = {rows}\nbands = {bands}\n"
        f"header offset = 0\ndata type = {codes[values.dtype.str[1:]]}\ninterleave = {interleave}\n"
        f"byte order = {int(big)}\nwavelength units = Nanometers\n"
        f"wavelength = {{{', '.join(f'{nm:g}' for nm in NM[:bands])}}}\n{more}"
    )
    at.with_suffix(".hdr").write_text(header)
    at.with_suffix(".img").write_bytes(values.transpose(AXES[interleave]).tobytes())
    return at.with_suffix(".hdr")


def write_spectral_exr(at: Path, values: np.ndarray, kind: str = "S0") -> Path:
    """Write channels as Fichet et al. name them."""
    channels = {
        f"{kind}.{f'{nm:.6f}'.replace('.', ',')}nm": np.ascontiguousarray(plane)
        for nm, plane in zip(NM, values, strict=True)
    }
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header | {"spectralLayoutVersion": "1.0"}, channels).write(str(at))
    return at


def rgbe(rgb: np.ndarray) -> np.ndarray:
    """Return RGB (rows, cols, 3) as mantissas and exponent, uint8 (rows, cols, 4)."""
    largest = rgb.max(axis=-1)
    _, exponent = np.frexp(largest)
    out = np.zeros((*rgb.shape[:2], 4), np.uint8)
    out[..., :3] = (rgb * np.ldexp(256.0, -exponent)[..., None]).astype(np.uint8)
    out[..., 3] = np.where(largest > 0, exponent + 128, 0)
    return out


def write_hdr(at: Path, rgb: np.ndarray, packed: bool = True, size: str = "-Y {} +X {}") -> Path:
    """Write a Radiance picture: of each component runs of equal bytes, and copies of others."""
    pixels = rgbe(rgb)
    rows, cols = pixels.shape[:2]
    head = "#?RADIANCE\n# made up\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2.0\nEXPOSURE=0.25\n\n"
    body = b""
    for line in pixels:
        if not packed:
            body += line.tobytes()
            continue
        body += bytes([2, 2, cols >> 8, cols & 255])
        for part in line.T:
            k = 0
            while k < cols:
                run = 1
                while k + run < cols and run < 127 and part[k + run] == part[k]:
                    run += 1
                if run > 2:
                    body += bytes([128 + run, part[k]])
                else:
                    run = min(2, cols - k)
                    body += bytes([run, *part[k : k + run]])
                k += run
    at.write_bytes((head + size.format(rows, cols) + "\n").encode() + body)
    return at


def photons(values: np.ndarray) -> np.ndarray:
    """Return photons (rows, cols, bands) of a radiance (bands, rows, cols)."""
    return np.moveaxis(values * (NM * 1e-9 / (H * C))[:, None, None], 0, -1)


def write_isetcam(at: Path, values: np.ndarray, kind: str = "struct") -> Path:
    """Write a radiance as a struct of photons, as coefficients of a basis, or as version 7.3."""
    lamp = {"data": {"photons": NM / (H * C) * 1e-9 * 2.0}, "spectrum": {"wave": NM}}
    counts = photons(values)
    if kind == "basis":
        mean = counts.mean(axis=(0, 1))
        u, s, v = np.linalg.svd((counts - mean).reshape(-1, len(NM)), full_matrices=False)
        given = {
            "mcCOEF": (u * s).reshape(*counts.shape[:2], -1),
            "basis": {"basis": v.T, "wave": NM},
            "imgMean": mean,
            "illuminant": {"data": np.full(len(NM), 2.0), "wavelength": NM},
            "comment": "made up",
        }
        savemat(at, given, do_compression=True)
    elif kind == "struct":
        scene = {"name": "made", "data": {"photons": counts}, "spectrum": {"wave": NM}}
        savemat(at, {"scene": scene | {"illuminant": lamp}}, do_compression=True)
    else:
        with h5py.File(at, "w", userblock_size=512) as file:
            scene = file.create_group("scene")
            scene["data/photons"] = counts.T  # MATLAB's axes are the other way round
            scene["spectrum/wave"] = NM[:, None]
            scene["illuminant/data/photons"] = lamp["data"]["photons"][:, None]
            scene["illuminant/spectrum/wave"] = NM[:, None]
    return at


def write_tiff(at: Path, values: np.ndarray) -> Path:
    """Write a TIFF."""
    tifffile.imwrite(at, values, photometric="rgb" if values.ndim == 3 else "minisblack")
    return at


def write_png(at: Path, values: np.ndarray) -> Path:
    """Write a PNG."""
    Image.fromarray(values).save(at)
    return at


def write_jpeg(at: Path, values: np.ndarray) -> Path:
    """Write a JPEG."""
    Image.fromarray(values).save(at)
    return at
