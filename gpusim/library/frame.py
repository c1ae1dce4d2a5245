"""Frames: what the sensor made of a light."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from gpusim.errors import UserError
from gpusim.isp.develop import develop
from gpusim.isp.dng import has_dng, write_dng
from gpusim.isp.files import image_of, write_picture
from gpusim.isp.histogram import channel_values
from gpusim.isp.levels import iso_speed, saturation_dn
from gpusim.library.notebook import curves, facts, figure, picture
from gpusim.library.recipe import write_sidecar
from gpusim.scene.exr import write_exr
from gpusim.sensor.frame import Areas, areas_of
from gpusim.sensor.readout import Shot

if TYPE_CHECKING:
    from gpusim.certify import Certificate
    from gpusim.library.light import Light

HISTOGRAM_BINS = 96


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame.

    Attributes
    ----------
    raw : ndarray (rows, cols), uint16
        Digital numbers.
    light : Light
        What was read, and the sensor that read it.
    shot : Shot
        Exposure (s), seed, frame number and temperature.
    noise : bool
        Whether noise and fixed patterns were drawn.

    Examples
    --------
    >>> frame = light.capture(1/60, seed=7)
    >>> frame.raw.shape, frame.raw.dtype, frame.electrons.dtype, frame.truth_dn.dtype
    ((48, 64), dtype('uint16'), dtype('float32'), dtype('float32'))
    >>> frame.exposure_s == 1/60, frame.iso, frame.certificate, int(frame.saturated.sum())
    (True, 100, None, 0)
    >>> frame.areas.lit
    (0, 0, 48, 64)
    """

    raw: np.ndarray
    light: Light
    shot: Shot
    noise: bool = True

    def __repr__(self) -> str:
        rows, cols = self.raw.shape
        return (
            f"Frame({self.light.title!r}, {self.light.scene!r}, {cols} x {rows} pixels, "
            f"{spoken_s(self.exposure_s)}, ISO {self.iso}, {self.saturated.mean():.2%} saturated)"
        )

    @property
    def exposure_s(self) -> float:
        """Exposure time, seconds."""
        return self.shot.exposure_s

    @property
    def iso(self) -> int:
        """ISO speed: the sensor's, or the saturation-based one of ISO 12232."""
        return iso_speed(self.light.sensor)

    @property
    def certificate(self) -> Certificate | None:
        """How far the light is from the exact one: see `Light.certificate`."""
        return self.light.certificate

    @cached_property
    def electrons(self) -> np.ndarray:
        """Electrons before the converter, noise included: (rows, cols), float32."""
        return self.light.read({"electrons": np.float32}, self.shot, self.noise)["electrons"]

    @cached_property
    def truth_dn(self) -> np.ndarray:
        """Mean signal in DN, without noise, fixed patterns and rounding: (rows, cols), float32."""
        return truth_dn(self.light, self.shot)

    @property
    def saturated(self) -> np.ndarray:
        """Which pixels are saturated: (rows, cols), bool."""
        return self.raw >= saturation_dn(self.light.sensor)

    @property
    def areas(self) -> Areas:
        """Which pixels see light, and which are shielded from it."""
        return areas_of(self.light.rect, self.light.sensor.frame)

    def histogram(self, bins: int = 256) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the raw's histogram by colour.

        Parameters
        ----------
        bins : int

        Returns
        -------
        edges_dn : ndarray (bins + 1,)
        counts : dict of str to ndarray (bins,)
            Pixels of each filter colour that see light.

        Examples
        --------
        >>> edges, counts = frame.histogram(bins=4)
        >>> edges.tolist()
        [0.0, 1024.0, 2048.0, 3072.0, 4096.0]
        >>> {letter: int(one.sum()) for letter, one in counts.items()}
        {'R': 768, 'G': 1536, 'B': 768}
        """
        row, col, rows, cols = self.areas.active
        lit = self.raw[row : row + rows, col : col + cols]
        edges = np.linspace(0, self.light.sensor.raw_max_dn + 1, bins + 1)
        values = channel_values(lit, self.light.sensor, self.areas.lit[:2])
        return edges, {name: np.histogram(one, edges)[0] for name, one in values.items()}

    def develop(self, ev: float = 0.0) -> Image.Image:
        """Return the picture: white balance as shot, colour matrix, sRGB; see `gpusim develop`.

        Parameters
        ----------
        ev : float
            By how many stops it is shown brighter.

        Examples
        --------
        >>> frame.develop(ev=1).size
        (64, 48)
        """
        with tempfile.TemporaryDirectory() as folder:
            sensor = self.light.sensor.cut(*self.areas.lit[:2])
            path = Path(folder) / ("raw.dng" if has_dng(sensor) else "raw.tif")
            self.write_raw(path, ev)
            return image_of(develop(path).picture)

    def save(self, path: str | Path, ev: float = 0.0, *, taken: datetime | None = None) -> None:
        """Write the frame to a file, whose suffix says as what.

        ``.dng``, or ``.tif`` where DNG has no way: the raw, and beside it in a ``.json`` what makes
        it again (`gpusim render --from`). ``.png``, ``.jpg``: the developed
        picture, `ev` stops brighter. ``.exr``: electrons. ``.npz``: raw, electrons, truth_dn,
        saturated, and with what they were taken. `taken`: the time in a raw, by default now.

        Raises
        ------
        UserError
            Another suffix, or the file cannot be written.

        Examples
        --------
        >>> frame.save("a.dng")
        >>> frame.save("a.png", ev=1)
        """
        path = Path(path)
        try:
            self._save(path, ev, taken)
        except OSError as error:
            raise UserError(
                f"the frame cannot be written: {error.strerror or error}",
                file=path,
                allowed="a file in a folder that is there",
            ) from error

    def _save(self, path: Path, ev: float, taken: datetime | None) -> None:
        suffix = path.suffix.lower()
        if suffix in (".dng", ".tif", ".tiff"):
            taken = taken or datetime.now(UTC)
            self.write_raw(path, ev, taken)
            write_sidecar(self, path, taken, ev=ev)
        elif suffix in (".png", ".jpg", ".jpeg"):
            write_picture(path, np.asarray(self.develop(ev)))
        elif suffix == ".exr":
            write_exr(path, {"Y": self.electrons}, units="e-")
        elif suffix == ".npz":
            np.savez(
                path,
                raw=self.raw,
                electrons=self.electrons,
                truth_dn=self.truth_dn,
                saturated=self.saturated,
                exposure_s=self.exposure_s,
                iso=self.iso,
                seed=self.shot.seed,
                frame=self.shot.frame,
            )
        else:
            raise UserError(
                "no such kind of file for a frame",
                file=path,
                value=suffix or "no suffix",
                allowed=".dng, .tif, .png, .jpg, .exr, .npz",
            )

    def write_raw(self, path: Path, ev: float, taken: datetime | None = None) -> None:
        """Write the raw as a DNG, or as a TIFF with its tags: see `save`.

        Examples
        --------
        >>> from pathlib import Path
        >>> frame.write_raw(Path("b.dng"), ev=0.0)
        """
        light, areas = self.light, self.areas
        sensor = light.sensor.cut(*areas.lit[:2])
        if path.suffix.lower() == ".dng" and not has_dng(sensor):
            raise UserError(
                "DNG has no way to say what this filter array is",
                file=path,
                field="sensor.cfa",
                allowed=".tif: the same tags in a TIFF",
            )
        write_dng(
            path,
            self.raw,
            sensor,
            white_e={name: one * self.exposure_s for name, one in light.white_e_per_s.items()},
            exposure_s=self.exposure_s,
            transmission=light.transmission,
            active_area=areas.active,
            masked_areas=areas.masked,
            optics=light.optics,
            place=areas.lit[:2],
            temperature_c=self.shot.temperature_c,
            ev=ev,
            taken=taken,
        )

    def _repr_html_(self) -> str:
        """Return picture, histogram and certificate for notebooks."""
        certificate = self.certificate
        verdict = "not certified"
        if certificate is not None:
            verdict = (
                f"total RMS {certificate.total_rms:.1e}, worst {certificate.total_worst:.1e}: "
                f"tolerance {self.light.tolerance} {'met' if certificate.met else 'not met'}"
            )
        told = {"": repr(self)[6:-1], "certificate": verdict}
        return figure(
            picture(self.develop()), facts(self.light.title, told), histogram_curves(self)
        )


def histogram_curves(frame: Frame) -> str:
    """Return a frame's histogram by colour for notebooks, square-root counts."""
    _, counts = frame.histogram(HISTOGRAM_BINS)
    return curves((letter, np.sqrt(one)) for letter, one in counts.items())


def truth_dn(light: Light, shot: Shot) -> np.ndarray:
    """Return the mean signal in DN, without noise, fixed patterns and rounding: (rows, cols), f32.

    EMVA 1288's linear model, mu_y = mu_y.dark + K mu_e (release 3.1, equation 3), with the sensor's
    non-linearity, as far as the converter's codes go.
    """
    sensor = light.sensor
    electrons = light.read({"electrons": np.float32}, shot, False)["electrons"]
    if sensor.linearity is not None:
        electrons = sensor.linearity.read(electrons)
    signal = np.float32(sensor.system_gain_dn_per_e) * electrons
    rows, cols = sensor.period
    black = np.asarray(sensor.site_black_dn, np.float32).reshape(rows, cols)
    first = light.rect[0] % rows, light.rect[1] % cols
    black = np.roll(black, (-first[0], -first[1]), (0, 1))
    times = [-(-size // period) for size, period in zip(signal.shape, (rows, cols), strict=True)]
    black = np.tile(black, times)[: signal.shape[0], : signal.shape[1]]
    return np.clip(signal + black, 0, sensor.raw_max_dn).astype(np.float32)


def spoken_s(exposure_s: float) -> str:
    """Return an exposure time as photographers write it."""
    if exposure_s >= 0.3:
        return f"{exposure_s:.3g} s"
    return f"1/{1 / exposure_s:.4g} s"
