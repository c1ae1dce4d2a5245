"""The camera's SFR at a field, from wavefronts: PSF, pixel aperture and cross-talk.

The SFR of an edge at `EDGE_DEG` to the columns, or to the rows, is |OTF(nu) T(nu)|: the OTF of all
wavelengths together in one channel, and the sensor's transfer T, which is taken along the edge's
normal; the OTF is taken along the rows or columns, 5 degrees from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.scene.spectra import illuminant
from gpusim.sensor.aperture import Response
from gpusim.sensor.sensor import Sensor
from gpusim.tolerance.wave import Line, Wave

EDGE_DEG = 5.0
ILLUMINANT = "D50"  # that charts are lit by
LINES = 7
FREQUENCY_CY_PX = np.linspace(0.0, 1.0, 81)
SAMPLES_AT_ONCE = 20


@dataclass(frozen=True)
class Channel:
    """The photosites that are measured, and the light they see.

    ``wavelengths_nm`` and ``weight`` (L,): electrons of a grey surface, over their sum.
    ``transfer`` (2, F): of the sensor at `FREQUENCY_CY_PX`, across upright and level edges.
    """

    name: str
    wavelengths_nm: np.ndarray
    weight: np.ndarray
    transfer: np.ndarray
    pitch_mm: float


def channel_of(sensor: Sensor, first_nm: float = 400.0, last_nm: float = 700.0) -> Channel:
    """Return the most frequent channel of a sensor, of equals the first, for light in a band."""
    sites = sensor.site_channels()
    name = max(dict.fromkeys(sites), key=sites.count)
    fine = np.arange(first_nm, last_nm + 1.0, 5.0)
    # Photons, not power: wavelength times radiance.
    electrons = {
        one: fine * illuminant(ILLUMINANT, fine) * curve
        for one, curve in sensor.qe_at(fine).items()
    }
    # Gauss's places in the band, each with the electrons of the light around it.
    at, width = np.polynomial.legendre.leggauss(LINES)
    lines_nm = first_nm + (last_nm - first_nm) * (at + 1) / 2
    weight = width * np.interp(lines_nm, fine, electrons[name])
    signal = {one: float(curve.sum()) for one, curve in electrons.items()}
    turn = np.radians(EDGE_DEG)
    transfer = []
    for nx, ny in ((np.cos(turn), np.sin(turn)), (np.sin(turn), np.cos(turn))):
        at = nx * FREQUENCY_CY_PX, ny * FREQUENCY_CY_PX
        transfer.append(_aperture(sensor, *at) * _crosstalk(sensor, name, signal, *at))
    pitch = 1e-3 * sensor.pixel_pitch_um
    return Channel(name, lines_nm, weight / weight.sum(), np.array(transfer), pitch)


def _aperture(sensor: Sensor, fx: np.ndarray, fy: np.ndarray) -> np.ndarray:
    response = sensor.response_um
    pitch = sensor.pixel_pitch_um
    if isinstance(response, Response):
        return np.abs(response.spectrum(fx / pitch, fy / pitch))
    return np.abs(np.sinc(fx * response / pitch) * np.sinc(fy * response / pitch))


def _crosstalk(
    sensor: Sensor, name: str, signal: dict[str, float], fx: np.ndarray, fy: np.ndarray
) -> np.ndarray:
    """Return what cross-talk leaves of a grey edge's modulation at photosites of a channel."""
    total = np.ones_like(fx)
    spread = sensor.crosstalk
    pattern = sensor.cfa.pattern
    for kernels in () if spread is None else (spread.optical, spread.electrical):
        if kernels is None:
            continue
        taken = kernels.shares(pattern)
        half = taken.shape[-1] // 2
        passed, whole = np.zeros(fx.shape, complex), 0.0
        for row, col, i, j in np.ndindex(taken.shape):
            if pattern[row][col] != name:
                continue
            y, x = i - half, j - half
            giver = pattern[(row + y) % len(pattern)][(col + x) % len(pattern[0])]
            share = taken[row, col, i, j] * signal[giver]
            passed += share * np.exp(2j * np.pi * (fx * x + fy * y))
            whole += share
        total = total * np.abs(passed) / whole
    return total


def otfs(
    wave: Wave,
    weight: np.ndarray,
    coefficients: np.ndarray,
    focus_mm: np.ndarray,
    frequency_cy_mm: np.ndarray,
) -> np.ndarray:
    """Return the OTF of all wavelengths together, along x and y of the lens.

    Parameters
    ----------
    wave : Wave
    weight : ndarray (L,)
    coefficients : ndarray (S, L, K)
        Coefficients of dW, mm.
    focus_mm : ndarray (S,)
        Way of the image plane away from the lens.
    frequency_cy_mm : ndarray (F,)

    Returns
    -------
    ndarray of complex, shape (S, 2, F)
        1 at frequency 0.
    """
    parts = []
    for start in range(0, len(focus_mm), SAMPLES_AT_ONCE):
        some = slice(start, start + SAMPLES_AT_ONCE)
        parts.append(
            sum(
                share * _line_otf(line, coefficients[some, k], focus_mm[some], frequency_cy_mm)
                for k, (line, share) in enumerate(zip(wave.lines, weight, strict=True))
            )
        )
    return np.concatenate(parts) / weight.sum()


def _field(line: Line, coefficients: np.ndarray, focus_mm: np.ndarray) -> np.ndarray:
    """Return the pupil's complex amplitude of each lens, (S, A, B)."""
    opd = line.opd_mm + np.tensordot(coefficients, line.basis, 1)
    opd = opd + focus_mm[:, None, None] * line.gamma
    return line.amplitude * np.exp(2j * np.pi / line.wavelength_mm * opd)


def _line_otf(
    line: Line, coefficients: np.ndarray, focus_mm: np.ndarray, frequency_cy_mm: np.ndarray
) -> np.ndarray:
    field = _field(line, coefficients, focus_mm)
    found = []
    # By Parseval's theorem the sum over one direction of the image is one over the pupil.
    for axis, step in zip((1, 2), line.step, strict=True):
        count = field.shape[axis]
        spread = np.abs(np.fft.fft(field, 2 * count, axis=axis)) ** 2
        lags = np.fft.ifft(spread.sum(axis=3 - axis), axis=1)
        lags = lags / lags[:, :1].real
        at = np.minimum(frequency_cy_mm * line.wavelength_mm / step, count - 3)
        found.append(sum(lags[:, lag] * share for lag, share in _between(at)))
    return np.stack(found, axis=1)


def _between(at: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return four whole lags, as indices into a circle of them, and their shares of a lag between.

    The cubic through them; tests/tolerance/test_wave.py holds it out to 60 um of defocus.
    """
    low = np.floor(at).astype(int)
    t = at - low
    shares = (
        -t * (t - 1) * (t - 2) / 6,
        (t + 1) * (t - 1) * (t - 2) / 2,
        -(t + 1) * t * (t - 2) / 2,
        (t + 1) * t * (t - 1) / 6,
    )
    return [(low + k - 1, share) for k, share in enumerate(shares)]


def through_focus(
    wave: Wave,
    weight: np.ndarray,
    coefficients: np.ndarray,
    focus_mm: np.ndarray,
    *,
    steps: int,
    step_mm: float,
    frequency_cy_mm: float,
) -> np.ndarray:
    """Return the MTF at one frequency over focus, (2 steps + 1, S): mean of both directions.

    Parameters
    ----------
    wave, weight, coefficients, focus_mm
        As of `otfs`: the middle.
    steps : int
        How many of ``step_mm``, either way.
    step_mm, frequency_cy_mm : float
    """
    found = np.zeros((2 * steps + 1, len(focus_mm), 2), complex)
    for start in range(0, len(focus_mm), SAMPLES_AT_ONCE):
        some = slice(start, start + SAMPLES_AT_ONCE)
        for k, (line, share) in enumerate(zip(wave.lines, weight, strict=True)):
            field = _field(line, coefficients[some, k], focus_mm[some] - steps * step_mm)
            turn = np.exp(2j * np.pi / line.wavelength_mm * step_mm * line.gamma)
            for row in found[:, some]:
                row += share * _overlap(line, field, frequency_cy_mm)
                field = field * turn
    return np.abs(found).mean(axis=-1) / weight.sum()


def _overlap(line: Line, field: np.ndarray, frequency_cy_mm: float) -> np.ndarray:
    """Return the pupil's overlap with itself at one frequency, (S, 2)."""
    found = []
    for axis, step in zip((1, 2), line.step, strict=True):
        along = np.moveaxis(field, axis, 1)
        count = along.shape[1]
        total = 0.0
        for lag, share in _between(np.array(frequency_cy_mm * line.wavelength_mm / step)):
            later, sooner = along[:, abs(lag) :], along[:, : max(count - abs(lag), 0)].conj()
            one = np.einsum("sab,sab->s", later, sooner)
            total = total + share * (one if lag >= 0 else one.conj())
        found.append(total)
    return np.stack(found, axis=1) / float((line.amplitude**2).sum())


def mtf50(sfr: np.ndarray) -> np.ndarray:
    """Return the first frequency, cycles/px, at which an SFR (..., F) falls to one half.

    What falls nowhere so far gives the last frequency.
    """
    flat = sfr.reshape(-1, sfr.shape[-1])
    below = flat < 0.5
    right = np.where(below.any(axis=1), below.argmax(axis=1), sfr.shape[-1] - 1)
    row = np.arange(len(flat))
    high, low = flat[row, right - 1], flat[row, right]
    share = np.clip((high - 0.5) / np.maximum(high - low, 1e-12), 0, 1)
    step = FREQUENCY_CY_PX[1]
    return ((right - 1 + share) * step).reshape(sfr.shape[:-1])
