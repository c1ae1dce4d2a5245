"""The job blur-1mp: an image blurred with PSFs of a grid of nodes, beside programs of others."""

from __future__ import annotations

import math
from importlib.util import find_spec

import numpy as np
import scipy.fft

from gpusim.gpu import Device
from gpusim.optics.blur import HALF, Blur

SIDE, CHANNELS, NODES, SIZE = 1024, 3, 9, 31
SPACING = SIDE // (NODES - 1)
LENGTH = 160  # of the transforms of the peers: a cell and a PSF, rounded up to 2^5 5


def made_psfs() -> np.ndarray:
    """Return PSFs (9, 9, 3, 31, 31) of unit sum: wider and more lopsided away from the middle."""
    across = np.linspace(-1, 1, NODES)
    v, u, channel = np.meshgrid(across, across, np.arange(CHANNELS), indexing="ij")
    u, v, channel = (part[..., None, None] for part in (u, v, channel))
    y, x = np.mgrid[:SIZE, :SIZE] - SIZE // 2
    width = 1.5 + 2 * np.hypot(u, v) + 0.2 * channel
    psfs = np.exp(-((x - 2 * u) ** 2 + (y - 2 * v) ** 2) / (2 * width**2))
    psfs *= 1 + 0.3 * (u * x + v * y) / SIZE
    return psfs / psfs.sum(axis=(-1, -2), keepdims=True)


def node_weights() -> np.ndarray:
    """Return the weights (2, SPACING) of the nodes on both sides of a cell."""
    s = (np.arange(SPACING) + 0.5) / SPACING
    return np.stack([1 - s, s])


def with_scipy(image: np.ndarray, psfs: np.ndarray, kind: type = np.float32):
    """Return the same interpolated model by SciPy: a run, in the precision asked for."""
    spectra = scipy.fft.rfft2(psfs.astype(kind), s=(LENGTH, LENGTH))
    cells = image.astype(kind).reshape(CHANNELS, NODES - 1, SPACING, NODES - 1, SPACING)
    cells = cells.transpose(1, 3, 0, 2, 4)
    weights = node_weights().astype(kind)

    def run() -> np.ndarray:
        total = 0
        for i, j in np.ndindex(2, 2):
            weighted = cells * (weights[i][:, None] * weights[j])
            part = scipy.fft.rfft2(weighted, s=(LENGTH, LENGTH), workers=2)
            part *= spectra[i : i + NODES - 1, j : j + NODES - 1]
            total = total + part
        return overlapped(scipy.fft.irfft2(total, s=(LENGTH, LENGTH), workers=2))

    return run


def overlapped(windows: np.ndarray) -> np.ndarray:
    """Add the windows (8, 8, C, T, T) where they lie, and cut the image out."""
    side = SIDE + LENGTH - SPACING
    out = np.zeros((CHANNELS, side, side), windows.dtype)
    for y, x in np.ndindex(NODES - 1, NODES - 1):
        top, left = y * SPACING, x * SPACING
        out[:, top : top + LENGTH, left : left + LENGTH] += windows[y, x]
    first = SIZE // 2
    return out[:, first : first + SIDE, first : first + SIDE]


def with_torch(image: np.ndarray, psfs: np.ndarray):
    """Return the same by PyTorch."""
    import torch

    torch.set_num_threads(2)
    spectra = torch.fft.rfft2(torch.tensor(psfs, dtype=torch.float32), s=(LENGTH, LENGTH))
    corners = [
        spectra[i : i + NODES - 1, j : j + NODES - 1].contiguous() for i, j in np.ndindex(2, 2)
    ]
    weights = torch.tensor(node_weights(), dtype=torch.float32)
    products = [weights[i][:, None] * weights[j] for i, j in np.ndindex(2, 2)]

    def run() -> np.ndarray:
        cells = torch.from_numpy(image).reshape(CHANNELS, NODES - 1, SPACING, NODES - 1, SPACING)
        cells = cells.permute(1, 3, 0, 2, 4)
        total = None
        for weight, corner in zip(products, corners, strict=True):
            part = torch.fft.rfft2(cells * weight, s=(LENGTH, LENGTH))
            part *= corner
            total = part if total is None else total.add_(part)
        return overlapped(torch.fft.irfft2(total, s=(LENGTH, LENGTH)).numpy())

    return run


def with_opencv(image: np.ndarray, psfs: np.ndarray):
    """Return OpenCV's filter2D with one PSF for each cell: seams, and a quarter of the work."""
    import cv2

    half = SIZE // 2
    kernels = psfs[..., ::-1, ::-1].astype(np.float32)

    def run() -> np.ndarray:
        out = np.empty_like(image)
        for y, x in np.ndindex(NODES - 1, NODES - 1):
            top, left = y * SPACING, x * SPACING
            above, before = max(top - half, 0), max(left - half, 0)
            for channel in range(CHANNELS):
                part = image[channel, above : top + SPACING + half, before : left + SPACING + half]
                filtered = cv2.filter2D(
                    part, -1, kernels[y, x, channel], borderType=cv2.BORDER_CONSTANT
                )
                out[channel, top : top + SPACING, left : left + SPACING] = filtered[
                    top - above :, left - before :
                ][:SPACING, :SPACING]
        return out

    return run


def blur_1mp(device: Device, job: type):
    """Time `gpusim.optics.blur` on 1024 x 1024 samples, 3 channels, 31 x 31 PSFs, 9 x 9 nodes."""
    image = np.random.default_rng(1).random((CHANNELS, SIDE, SIDE), np.float32)
    psfs = made_psfs()
    made = Blur(psfs, (SIDE, SIDE), SPACING, device)
    exact = with_scipy(image, psfs, np.float64)()
    worst = np.abs(made(image) - exact).max() / exact.max()
    peers = {"scipy": (with_scipy(image, psfs), 1.0)}
    if find_spec("torch"):
        peers["torch"] = (with_torch(image, psfs), 1.0)
    if find_spec("cv2"):
        peers["opencv hard patches"] = (with_opencv(image, psfs), 1.0)
    # Rows: one transform each; of each column four for the nodes' weights and one back, and four
    # products; rows back, two by two.
    blocks, side = math.prod(made.blocks), made.side
    lines = side + HALF * 5 + LENGTH // 2
    each = 5 * lines * LENGTH * math.log2(LENGTH) + 8 * 4 * HALF * LENGTH
    return job(
        lambda: made(image),
        CHANNELS * SIDE**2,
        {"measure": "largest difference from float64 over the peak", "worst": float(worst)},
        peers=peers,
        flops=round(CHANNELS * blocks * each),
    )
