#!/usr/bin/env python
"""Draw what charge-transfer inefficiency does to colours: a hue that shifts across the array.

    .venv/bin/python tools/ccd_figure.py FILE.png

Kodak's interline CCD of 640 x 480 pixels with a Bayer pattern (Short, Williams and Jones 1999 name
the effect) sees bands of even colour. Every number comes from the sensor's own stages.
"""

from __future__ import annotations

import argparse
import textwrap
from pathlib import Path

import colour
import matplotlib
import numpy as np
from matplotlib.figure import Figure

from gpusim.gpu import default_device
from gpusim.isp.colour import colour_matrix, response
from gpusim.scene.spectra import colorchecker, white_radiance, xyz
from gpusim.sensor.ccd import ReadOut
from gpusim.sensor.cti_model import Cti, Species
from gpusim.sensor.load import load_sensor
from gpusim.sensor.readout import Shot
from gpusim.sensor.sensor import Sensor
from gpusim.validate.kodak_noise import ILLUMINANT, PATCHES, WHITE_SHARE, odd_share

TYPICAL, STRONG = 5e-5, 5e-4  # left behind in each transfer of the serial register
LEVELS = (0.5, 0.1, 0.02)  # greys for the traps, of the full well
TRAPS = Species(density=2.0, release_transfers=1.0)
STRIP_BYTES = 1 << 26
CAPTION_COLUMNS = 150
STYLE = {"font.family": "DejaVu Sans", "font.size": 9.0, "axes.edgecolor": "#667080"}
SHOWN = {"R": "#c2185b", "B": "#2463ad"}


def charge_of(
    light: np.ndarray, sensor: Sensor, serial: Cti | None, noise: bool = False
) -> np.ndarray:
    """Return the electrons that are read from mean electrons (rows, cols)."""
    changed = sensor.model_copy(update={"serial_cti": serial, "full_well_e": 1e7})
    changed = changed.model_copy(
        update={"dark_current_e_per_s": 0.0, "prnu_percent": 0.0, "dsnu_e": 0.0}
    )
    runs = {"noise", "read noise"} if noise else set()
    runs |= {"serial cti"} if serial else set()
    read_out = ReadOut(
        default_device(),
        changed,
        Shot(1.0, 1, 0),
        runs.__contains__,
        STRIP_BYTES,
        lambda rec: rec.run(),
    )
    rect = (0, 0, sensor.rows, sensor.cols)
    charge, found = np.empty(light.shape, np.float32), np.empty(light.shape, np.float32)
    read_out.columns(light.astype(np.float32), rect, charge)
    read_out.rows(charge, 0, rect, {"electrons": found})
    return found.astype(float)


def planes(charge: np.ndarray, sensor: Sensor) -> np.ndarray:
    """Return red, green (the mean of both) and blue of each filter pattern: (3, rows, cols)."""
    of = {name: [] for name in "RGB"}
    for site, name in enumerate(sensor.site_channels()):
        of[name].append(charge[site // 2 :: 2, site % 2 :: 2])
    return np.stack([np.mean(of[name], axis=0) for name in "RGB"])


def frame(colours: np.ndarray, sensor: Sensor) -> np.ndarray:
    """Return mean electrons of bands of colours (bands, 3) from top to bottom."""
    band = np.arange(sensor.rows) // 2 * 2 * len(colours) // sensor.rows
    sites = [["RGB".index(name) for name in row] for row in sensor.cfa.pattern]
    channel = np.tile(sites, (sensor.rows // 2, sensor.cols // 2))
    return colours[band[:, None], channel]


def main() -> None:
    """Draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("file", type=Path)
    file = parser.parse_args().file
    sensor = load_sensor("kodak-vga")
    seen = response(sensor.qe)
    white = white_radiance(ILLUMINANT, 1.0)
    patches = np.stack([colorchecker()[name] for name in PATCHES])
    unit = WHITE_SHARE * sensor.full_well_e / (seen @ white).max()
    bands = unit * (patches * white) @ seen.T
    light = frame(bands, sensor)
    to_xyz = np.linalg.inv(colour_matrix(seen, ILLUMINANT))
    # The white comes out as the white.
    scale = to_xyz @ (seen @ white) / (xyz(white) / xyz(white)[1])

    def developed(charge: np.ndarray) -> np.ndarray:
        camera = np.moveaxis(planes(charge, sensor), 0, -1) / unit
        return camera @ to_xyz.T / scale

    def srgb(image: np.ndarray) -> np.ndarray:
        linear = image @ colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB.T
        return colour.cctf_encoding(np.clip(linear, 0, 1), function="sRGB")

    strong = charge_of(light, sensor, Cti(inefficiency=STRONG))
    typical = charge_of(light, sensor, Cti(inefficiency=TYPICAL))
    noisy = planes(charge_of(light, sensor, Cti(inefficiency=TYPICAL), noise=True), sensor)
    middle = [int((i + 0.5) * sensor.rows / len(PATCHES) / 2) for i in range(len(PATCHES))]
    lab = [
        colour.XYZ_to_Lab(developed(one)[middle], (0.3127, 0.3290))
        for one in (light, typical, strong)
    ]
    edge = [colour.delta_E(lab[0][:, -2], one[:, -2], method="CIE 2000") for one in lab[1:]]

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 7.4))
        for number, (charge, title) in enumerate(
            (
                (light, "as the light falls"),
                (strong, f"serial register, {STRONG:g} left behind in each transfer"),
            )
        ):
            axes = figure.add_axes((0.05 + 0.49 * number, 0.51, 0.44, 0.43))
            axes.imshow(srgb(developed(charge)), extent=(0, sensor.cols, sensor.rows, 0))
            axes.set_title(title, loc="left", fontsize=10)
            axes.set_yticks([])
            axes.set_xticks([0, 160, 320, 480, 640])
        column = np.arange(sensor.cols // 2) * 2
        axes = figure.add_axes((0.08, 0.17, 0.40, 0.255))
        grey = np.s_[: sensor.rows // len(PATCHES) // 2 - 2]
        red, green, blue = bands[0]
        # The share of a packet that fell behind an odd number of times, and is of the other filter.
        odd = odd_share(column, TYPICAL)
        mixed = (1 - odd) * green + odd * (red + blue) / 2
        for name, own in (("R", red), ("B", blue)):
            found = noisy[0 if name == "R" else 2, grey].mean(0) / noisy[1, grey].mean(0)
            law = ((1 - odd) * own + odd * green) / mixed
            start = own / green
            axes.plot(column, 100 * (found / start - 1), ".", ms=2.5, color=SHOWN[name], alpha=0.45)
            axes.plot(column, 100 * (law / start - 1), color=SHOWN[name], label=f"{name}/G")
        axes.set_title(f"grey, {TYPICAL:g} in each transfer: shift of R/G, B/G", loc="left")
        axes.set_ylabel("per cent")
        axes.set_xlabel("column, from the read-out")
        axes.legend(frameon=False)
        axes.grid(color="#e3e6ea")

        axes = figure.add_axes((0.57, 0.17, 0.40, 0.255))
        model = Cti(traps=(TRAPS,), groups=8)
        level_text = []
        for level, width in zip(LEVELS, (1.0, 1.6, 2.4), strict=True):
            even = frame(bands[:1] / bands[0].max() * level * sensor.full_well_e, sensor)
            found = planes(
                charge_of(even, sensor, model.model_copy(update={"well_e": sensor.full_well_e})),
                sensor,
            ).mean(axis=1)
            ratio = found[0] / found[1]
            shift = 100 * (ratio / (red / green) - 1)
            axes.plot(
                column, shift, color=SHOWN["R"], lw=width, label=f"{level:.0%} of the full well"
            )
            level_text.append(f"{shift[-1]:+.1f}")
        axes.set_title("grey, traps: shift of R/G goes with the signal", loc="left")
        axes.set_xlabel("column, from the read-out")
        axes.legend(frameon=False)
        axes.grid(color="#e3e6ea")
        at = ", ".join(f"{level:.0%}" for level in LEVELS)
        at_strong, at_typical = (f"{one.min():.2g} to {one.max():.2g}" for one in edge[::-1])
        caption = textwrap.fill(
            f"{sensor.name}, serial register. In each transfer a packet leaves part of its charge "
            "to the next one, which has another filter: hues shift with the distance from the "
            f"read-out. At the last columns of the seven bands dE2000 is {at_strong} where "
            f"{STRONG:g} is left behind, and {at_typical} where it is {TYPICAL:g}. Points: one "
            f"noisy frame; lines: closed form. Traps ({TRAPS.density:g} in each pixel, released "
            f"in {TRAPS.release_transfers:g} transfer) hold a larger share of a small signal: R/G "
            f"{', '.join(level_text)} % at the last column for {at} of the full well.",
            CAPTION_COLUMNS,
        )
        figure.text(0.05, 0.015, caption, fontsize=8.5, va="bottom")
        figure.savefig(file, dpi=120)
    print(caption)


if __name__ == "__main__":
    main()
