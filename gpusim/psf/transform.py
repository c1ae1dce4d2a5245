"""From pupils on the device to PSFs: the stages pupil, fft along and fft across.

Nodes hold W and the rim, on half of a pupil whose other half mirrors it, or on a whole one. The
field is put on the transform's grid in any image plane, and transformed.
"""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording

TRANSFORM = 1024  # cells each way: with a pitch of 0.5 um the PSF repeats after 512 um
FIRST_RADIX = {512: 8, 1024: 2}  # for shaders/common/line_fft: length = FIRST_RADIX 8^k
# Rays fade from so many windows' widths off the chief ray on: none lands in the window from there.
# For the Tessar at f/2.8, 20 deg, of whose light 10 % lands beyond the period, line spreads are off
# by 1.5e-4 with 0.5, 0.75 and 1, 7e-4 with 1.45 (a rim, nearly) and 8e-2 where nothing fades.
FADES_FROM = 0.75

# shaders/common/grid
GRID = np.dtype(
    [
        ("first", "f4", 2),
        ("step", "f4", 2),
        ("origin", "f4", 2),
        ("chief", "f4", 2),
        ("cell", "f4"),
        ("waves_per_mm", "f4"),
    ]
)


def uploaded_grids(rec: Recording, grids: np.ndarray) -> Array:
    """Put grids (L,) of `GRID` on the device for one recording."""
    values = grids.view(np.float32).reshape(len(grids), -1)
    array = rec.buffer("grids", values.shape, "f4")
    rec.upload(array, values)
    return array


class Transform:
    """What turns nodes of a pupil into PSFs.

    Parameters
    ----------
    device : Device
    pitch_um, size : float, int
        Pitch and size of the PSFs; size at most half of the cells.
    cells : int
        Cells of the pupil each way, 512 or 1024: the PSF repeats after so many samples.
    mirrored : bool
        Whether nodes are those of half the pupil, alpha > 0, and the other half mirrors it.
    """

    def __init__(
        self,
        device: Device,
        *,
        pitch_um: float,
        size: int,
        cells: int = TRANSFORM,
        mirrored: bool = True,
    ) -> None:
        self.device, self.pitch_um, self.size = device, pitch_um, size
        self.cells, self.mirrored = cells, mirrored
        phase = -2j * np.pi * np.arange(cells) / cells
        self._twiddle = device.resident("twiddle", np.exp(phase).astype(np.complex64))

    def spread(
        self, grids: np.ndarray, nodes: Array, exponent: Array, rows: int, focus_mm: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the PSFs of L beams, and the light and the share of it that would fold.

        Parameters
        ----------
        grids : ndarray of GRID, shape (L,)
        nodes, exponent : Array (L, A, B, 2) and (L, A, B) of f32, on the device
            See shaders/psf/pupil.
        rows : int
            Rows of cells along alpha, as many as the widest pupil takes.
        focus_mm : float
            How far the image plane is moved away from the lens.

        Returns
        -------
        psf : ndarray of float32 (L, size, size)
            Share of the light per sample; rows along alpha, columns along beta, sample j at
            (j - size / 2) pitch.
        light : ndarray (L,)
            Sum over the pupil's cells, on half of it where that is mirrored.
        folded : ndarray (L,)
            Share of it that lands beyond the transform's period, and is in no PSF.
        """
        lines, size, cells = len(grids), self.size, self.cells
        _, na, nb, _ = nodes.shape
        high = size // 2 + 1 if self.mirrored else size
        rec = Recording(self.device)
        filled = rec.buffer("field", (lines, rows, cells, 2), "f4")
        sums = rec.buffer("sums", (lines, rows, 2), "f4")
        half = rec.buffer("lines", (lines, size, rows, 2), "f4")
        intensity = rec.buffer("intensity", (lines, high, size), "f4")
        Kernel("psf/pupil", T=cells, NB=nb, MIRRORED=self.mirrored).record(
            rec,
            (rows, lines, 1),
            {
                "na": na,
                "fade_um": FADES_FROM * size * self.pitch_um,
                "fold_um": (cells - size / 2) * self.pitch_um,
                "focus_mm": focus_mm,
            },
            grids=uploaded_grids(rec, grids),
            nodes=nodes,
            exponent=exponent,
            field=filled,
            sums=sums,
        )
        overrides = {
            "T": cells,
            "LANES": cells // 8,
            "FIRST_RADIX": FIRST_RADIX[cells],
            "N": size,
        }
        Kernel("psf/fft_along", **overrides).record(
            rec,
            (-(-rows // 2), lines, 1),
            {"rows": rows},
            twiddle=self._twiddle,
            field=filled,
            lines=half,
        )
        Kernel("psf/fft_across", **overrides, MIRRORED=self.mirrored).record(
            rec,
            (size // 2, lines, 1),
            {"rows": rows},
            twiddle=self._twiddle,
            lines=half,
            intensity=intensity,
        )
        rec.download(sums)
        rec.download(intensity)
        found = rec.run()
        light, folded = found["sums"].sum(axis=1, dtype=float).T
        psf = found["intensity"]
        if self.mirrored:
            # The first row is eta = 0; the halves mirror one another.
            psf = np.concatenate([psf[:, :0:-1], psf[:, : size // 2]], axis=1)
        # Parseval: all of the light is T^2 times the sum over the whole pupil.
        whole = (2 if self.mirrored else 1) * light * cells**2
        psf /= whole.astype(np.float32)[:, None, None]
        return psf, light, folded / light

    def release(self) -> None:
        """Give the device memory back."""
        self._twiddle.destroy()
