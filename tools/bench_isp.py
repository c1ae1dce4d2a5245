"""Jobs of tools/bench.py for the development of raw files."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from gpusim.gpu import Device
from gpusim.isp.dng import write_dng
from gpusim.isp.pipeline import develop_source
from gpusim.isp.settings import Settings
from gpusim.isp.source import Source, read_source
from gpusim.isp.transfer import SPACES
from gpusim.isp.white import to_picture
from gpusim.reference.balance import balance
from gpusim.reference.colours import colours
from gpusim.reference.differences import differences
from gpusim.reference.direction import direction
from gpusim.reference.linear import linear
from gpusim.reference.malvar import malvar
from gpusim.reference.matrix import matrix
from gpusim.reference.refine import refine
from gpusim.reference.transfer import transfer
from gpusim.sensor.load import load_sensor

WHITE_E = {"R": 2600.0, "G": 5000.0, "B": 3100.0}
PART = 64  # side of what the error is found on, pixels
RIM = 8  # of it, into which the reference's own rim reaches
WAVES = (97.0, 61.0, 7.3)  # pixels: periods of what the frame shows
PEER_SHARE = 4  # of the frame: the other programs hold dozens of planes of float64 at once


def frame_of(frame: tuple[int, int], folder: Path) -> Path:
    """Write a raw file of waves and noise; return its path."""
    sensor = load_sensor("imx477")
    row, col = np.ogrid[: frame[0], : frame[1]]
    wave = sum(np.sin(2 * np.pi * (row + 0.7 * col) / period) for period in WAVES)
    level = 1200 + 250 * wave + np.random.default_rng(1).normal(0, 8, frame)
    path = folder / "bench.dng"
    write_dng(path, level.astype(np.uint16), sensor, white_e=WHITE_E, exposure_s=0.01)
    return path


def develop_job(device: Device, frame: tuple[int, int], method: str, job: Callable) -> object:
    """Time a frame from its codes to a picture of 8 bits, both in memory."""
    folder = tempfile.TemporaryDirectory()
    path = frame_of(frame, Path(folder.name))
    source = read_source(path)
    settings = Settings(demosaic=method)

    def run() -> object:
        return develop_source(source, settings, device)

    return job(
        run,
        frame[0] * frame[1],
        _error(device, source, settings),
        peers=_peers(source, path, method, folder),
        facts=lambda best: {"stages_s": best.times_s},
    )


def _error(device: Device, source: Source, settings: Settings) -> dict[str, object]:
    """Return the largest difference from the references in a part of the frame."""
    part = replace(source, codes=source.codes[:PART, :PART])
    found = develop_source(part, settings, device, bits=16).picture / 65535
    pattern = np.array([list(line) for line in source.pattern])
    shares = dict(zip(source.colours, source.neutral, strict=True))
    gain = np.vectorize(lambda letter: 1 / shares[letter])(pattern)
    light = balance(linear(part.codes, source.black, source.span), gain)
    row, col = np.argwhere(pattern == "R")[0]
    light = light[row : PART - row, col : PART - col]  # red first
    if settings.demosaic == "malvar":
        planes = malvar(light)
    else:
        more, chosen = direction(differences(light))
        planes = colours(light, chosen, refine(chosen, more >= 0), more >= 0)
    space = SPACES["srgb"]
    rgb = matrix(planes, to_picture(source.neutral, source.matrices, space.chromaticities))
    expected = transfer(rgb, **vars(space.transfer)).transpose(1, 2, 0)
    inner = slice(RIM, -RIM), slice(RIM, -RIM)
    found = found[row : PART - row, col : PART - col][inner]
    worst = np.abs(found - expected[inner]).max() / expected[inner].max()
    return {"measure": "largest difference over largest value", "worst": float(worst)}


def _peers(
    source: Source, path: Path, method: str, folder: tempfile.TemporaryDirectory
) -> dict[str, tuple[Callable[[], object], float]]:
    """Return what others do: whole development by LibRaw; demosaicing alone by the rest."""
    import rawpy

    ways = {"malvar": (), "directional": ("AHD",)}[method]

    def libraw(way: str) -> object:
        with rawpy.imread(str(Path(folder.name) / path.name)) as raw:
            return raw.postprocess(
                demosaic_algorithm=rawpy.DemosaicAlgorithm[way],
                use_camera_wb=True,
                no_auto_bright=True,
            )

    peers = {f"LibRaw {way}": (lambda way=way: libraw(way), 1.0) for way in ("LINEAR", *ways)}
    codes = source.codes[: source.codes.shape[0] // PEER_SHARE // 2 * 2]
    share = source.codes.size / codes.size
    try:
        import colour_demosaicing as others
    except ImportError:
        pass
    else:
        name = {"malvar": "Malvar2004", "directional": "Menon2007"}[method]
        demosaic = getattr(others, f"demosaicing_CFA_Bayer_{name}")
        pattern = "".join(source.pattern)
        peers[f"colour-demosaicing {name}, demosaicing alone"] = (
            lambda: demosaic(codes / 65535, pattern),
            share,
        )
    try:
        import cv2
    except ImportError:
        return peers
    code = {"malvar": cv2.COLOR_BayerRGGB2RGB, "directional": cv2.COLOR_BayerRGGB2RGB_EA}[method]
    what = {"malvar": "bilinear", "directional": "edge-aware"}[method]
    peers[f"OpenCV {what}, demosaicing alone"] = (lambda: cv2.cvtColor(source.codes, code), 1.0)
    return peers
