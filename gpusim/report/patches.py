"""Patches of a colour chart in the developed picture, beside what the chart is: Delta E of each.

Where a patch lies is known: from the chart through the lens's distortion. The chart's colours are
those of the scene's spectra, for the CIE's observer of 1931; the picture's are its sRGB, adapted to
the scene's white. Its exposure is free: one factor is fitted to the luminances.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.metrics.colour import Colours, compared
from gpusim.report.template import filled
from gpusim.scene.chart import Chart, Rect
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, adaptation, encode_srgb, rgb_to_xyz
from gpusim.scene.encoded import linear
from gpusim.scene.spectra import patch_names, seen_by_eye, xyz

if TYPE_CHECKING:
    from gpusim.render import Capture

INNER = 0.6  # of a patch's sides: the part that is measured
LEAST_PX = 4  # sides of that part
SOURCE = Path("developed.png")
MANY = 8  # patches in a row
FEWEST = 6  # patches: with fewer a fitted exposure says little


def patch_facts(capture: Capture, developed: np.ndarray) -> dict[str, Any] | None:
    """Return the patches that a capture shows; None where the scene has none, or it no colours.

    Parameters
    ----------
    capture : Capture
    developed : ndarray (rows, cols, 3), uint8
        sRGB.
    """
    chart, optics = capture.scene.source, capture.optics
    if not isinstance(chart, Chart) or not optics.ideal_um.size:
        return None
    if len(capture.camera.sensor.colour_qe) < 3:
        return None
    known = set(patch_names())
    found = []
    for shape in chart.primitives:
        name = chart.materials[shape.material]
        if name in known and isinstance(shape, Rect) and shape.angle_rad == 0:
            box = _box(shape, capture, developed.shape)
            if box is not None:
                found.append((name, shape.material, box))
    if len(found) < FEWEST:
        return None
    names, materials, boxes = zip(*found, strict=True)
    scene = capture.scene
    eye = seen_by_eye(scene.wavelengths_nm)
    white = xyz(scene.white[eye])
    chart_xyz = xyz(scene.spectra[list(materials)][:, eye]) / white[1]
    white = white / white[1]
    parts = [developed[top:bottom, left:right] for left, top, right, bottom in boxes]
    clipped = np.array([_clipped(one) for one in parts])
    rgb = np.stack([linear(one / 255, "srgb", SOURCE).mean(axis=(0, 1)) for one in parts])
    to_xyz = rgb_to_xyz(REC709_CHROMATICITIES)
    own = rgb @ to_xyz.T @ adaptation(to_xyz.sum(axis=1), white).T
    used = ~clipped if (~clipped).sum() >= FEWEST else np.ones(len(own), bool)
    own *= own[used, 1] @ chart_xyz[used, 1] / (own[used, 1] @ own[used, 1])
    colours = compared(own, chart_xyz, white)
    back = adaptation(white, to_xyz.sum(axis=1)).T @ np.linalg.inv(to_xyz).T
    return {
        "illuminant": scene.illuminant,
        "mean_delta_e_2000": float(colours.delta_e["2000"][used].mean()),
        "largest_delta_e_2000": float(colours.delta_e["2000"][used].max()),
        "patches": [
            _patch(
                at, names, boxes, clipped=clipped, colours=colours, chart_xyz=chart_xyz, to_rgb=back
            )
            for at in range(len(names))
        ],
    }


def _patch(
    at: int,
    names: tuple[str, ...],
    boxes: tuple[tuple[int, int, int, int], ...],
    *,
    clipped: np.ndarray,
    colours: Colours,
    chart_xyz: np.ndarray,
    to_rgb: np.ndarray,
) -> dict[str, Any]:
    seen, own = chart_xyz[at], colours.xyz[at]
    return {
        "name": names[at],
        "box_px": list(boxes[at]),
        "clipped": bool(clipped[at]),
        "chart_xy": (seen[:2] / seen.sum()).tolist(),
        "xy": (own[:2] / max(own.sum(), 1e-30)).tolist(),
        "chart_srgb": _code(seen @ to_rgb),
        "srgb": _code(own @ to_rgb),
        "delta_e_2000": float(colours.delta_e["2000"][at]),
    }


def _clipped(part: np.ndarray) -> bool:
    """Return whether a patch is too bright, too dark or too saturated for sRGB in most pixels."""
    ends = (part == 0) | (part == 255)
    return bool(ends.mean(axis=(0, 1)).max() > 0.5)


def _code(linear: np.ndarray) -> str:
    red, green, blue = np.round(255 * encode_srgb(linear)).astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _box(shape: Rect, capture: Capture, size: tuple[int, ...]) -> tuple[int, int, int, int] | None:
    """Return the pixels (left, top, right, bottom) of a patch's inner part, if all are there."""
    sensor, optics = capture.camera.sensor, capture.optics
    first_row, first_col, *_ = capture.areas.lit
    half_um = sensor.rows * sensor.pixel_pitch_um / 2
    sides = np.array([-1.0, 1.0]) * INNER
    x, y = np.meshgrid(
        (shape.cx + sides * shape.half_w) * half_um, (shape.cy + sides * shape.half_h) * half_um
    )
    distance = np.hypot(x, y)
    if distance.max() > optics.ideal_um[-1]:
        return None
    real = np.interp(distance, optics.ideal_um, optics.real_um)
    scale = real / np.maximum(distance, 1e-9) / sensor.pixel_pitch_um
    col = sensor.cols / 2 + x * scale - first_col
    row = sensor.rows / 2 + y * scale - first_row
    left, right = int(np.ceil(col[:, 0].max())), int(np.floor(col[:, 1].min()))
    top, bottom = int(np.ceil(row[0].max())), int(np.floor(row[1].min()))
    whole = left >= 0 and top >= 0 and right <= size[1] and bottom <= size[0]
    large = min(right - left, bottom - top) >= LEAST_PX
    return (left, top, right, bottom) if whole and large else None


def patches_html(found: dict[str, Any] | None) -> str:
    """Return the patches side by side, the chart's colour around the picture's."""
    if found is None:
        return ""
    rows: list[list[dict[str, Any]]] = []
    for one in found["patches"]:
        top, left = one["box_px"][1], one["box_px"][0]
        # A new row begins where a patch lies to the left of the one before it.
        if not rows or left <= rows[-1][-1]["box_px"][0] or top > rows[-1][-1]["box_px"][3]:
            rows.append([])
        rows[-1].append({**one, "dark": _dark(one["chart_srgb"])})
    return filled(
        "report/templates/patches.html",
        found=found,
        rows=rows,
        many=max(map(len, rows)) > MANY,  # no room for figures on a phone
        clipped=sum(one["clipped"] for one in found["patches"]),
    )


def _dark(code: str) -> bool:
    """Return whether white letters go with a colour: its channels lie below 110 on average."""
    return sum(int(code[at : at + 2], 16) for at in (1, 3, 5)) < 3 * 110
