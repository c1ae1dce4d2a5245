"""A linear camera in NumPy, which shares nothing with the product: frames of known parameters."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tifffile

from gpusim.metrics.statistics import Accumulator, Level


@dataclass
class Camera:
    """EMVA 1288's linear camera: section 2 of release 3.1."""

    gain: float = 0.8
    efficiency: float = 0.55
    noise_e: float = 4.0
    current_e_per_s: float = 20.0
    offset_e: float = 2.0
    offset_row_e: float = 0.0
    response: float = 0.02
    response_col: float = 0.0
    row_noise_e: float = 0.0
    black_dn: float = 40.0
    full_e: float = 4000.0
    top: int = 4095
    after_shot_noise: bool = False
    shape: tuple[int, int] = (96, 80)
    seed: int = 5
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        rows, cols = self.shape
        self.responses = (
            1
            + self.response * self.rng.standard_normal(self.shape)
            + self.response_col * self.rng.standard_normal(cols)
        )
        self.offsets = self.offset_e * self.rng.standard_normal(
            self.shape
        ) + self.offset_row_e * self.rng.standard_normal((rows, 1))

    def frame(self, photons: float, exposure_s: float) -> np.ndarray:
        """Take a frame."""
        light = self.efficiency * photons * np.ones(self.shape)
        before, after = (1.0, self.responses) if self.after_shot_noise else (self.responses, 1.0)
        charge = self.rng.poisson(light * before + self.current_e_per_s * exposure_s) * after
        charge = np.minimum(charge, self.full_e) + self.offsets
        charge = charge + self.noise_e * self.rng.standard_normal(self.shape)
        charge = charge + self.row_noise_e * self.rng.standard_normal((self.shape[0], 1))
        return np.clip(np.round(self.gain * charge + self.black_dn), 0, self.top).astype(np.uint16)

    def level(
        self, photons: float, exposure_s: float = 0.01, frames: int = 2, nm: float = 500.0
    ) -> Level:
        """Take some frames of one light."""
        statistics = Accumulator((1, 1))
        for _ in range(frames):
            statistics.add(self.frame(photons, exposure_s))
        return Level(exposure_s, photons, nm if photons else None, statistics.sites())

    def levels(self, count: int = 55, stack: int = 32) -> list[Level]:
        """Return a whole measurement."""
        full = self.full_e / self.efficiency
        found = [self.level(0.0, time) for time in np.arange(1, 7) * 2.0]
        found += [self.level(0.0, frames=stack), self.level(full / 2, frames=stack)]
        return found + [self.level(1.1 * full * (k + 1) / count) for k in range(count)]


def write(folder: Path, lights, suffix=".npy", camera=None, shape=(24, 20)) -> Path:
    """Write frames and their list: (exposure, photons, how many)."""
    folder.mkdir(exist_ok=True)
    made = Camera(shape=shape)
    lines = ["file,exposure_s,photons,wavelength_nm"]
    for exposure, photons, count in lights:
        for _ in range(count):
            name = f"{len(lines)}{suffix}"
            frame = made.frame(photons, exposure)
            if suffix == ".npy":
                np.save(folder / name, frame)
            else:
                tifffile.imwrite(folder / name, frame)
            lines.append(f"{name},{exposure},{photons},{550 if photons else ''}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    if camera is not None:
        (folder / "camera.json").write_text(json.dumps(camera))
    return folder
