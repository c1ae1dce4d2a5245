"""The lens to scale: glass, stop, image plane, and the rays of a few fields."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from gpusim.lens.section import Element, section
from gpusim.lens.system import System
from gpusim.report.drawing import INK, SOFT
from gpusim.report.lens.colours import PALETTE
from gpusim.report.lens_page import round_near


def draw_layout(
    axes: Axes, system: System, glass: list[Element], beams: list[np.ndarray], image_um: float
) -> None:
    """Draw glass, stop, image plane and the rays of three fields, to scale.

    ``image_um`` is half the height of the image.
    """
    axes.axis("off")
    for element in glass:
        # Crowns are light, flints dark: Abbe numbers from 70 to 20.
        depth = float(np.clip((70 - element.abbe) / 50, 0, 1))
        face = _mix("#e8f1fb", "#8fb0d8", depth)
        axes.add_patch(
            Polygon(element.outline, facecolor=face, edgecolor="#3c5878", linewidth=0.8, zorder=2)
        )
    for paths, colour in zip(beams, PALETTE, strict=False):
        for number in range(paths.shape[1]):
            axes.plot(*paths[:, number].T, color=colour, linewidth=0.6, zorder=3)
    circle = 1.06e-3 * image_um
    image = np.array([[system.image_z_mm, circle], [system.image_z_mm, -circle]])
    drawn = [paths.reshape(-1, 2) for paths in beams] + [e.outline for e in glass]
    low, high = _to_scale(axes, np.concatenate([*drawn, image]))
    unit = (high[0] - low[0]) / axes.get_position().width / axes.figure.get_figwidth()  # an inch
    axes.plot([low[0], high[0]], [0, 0], color=SOFT, linewidth=0.5, dashes=(12, 3, 2, 3), zorder=1)
    axes.plot(*image.T, color=INK, linewidth=1.6)
    _under(axes, system.image_z_mm, -circle, "image")
    radius = system.stop_radius_mm
    stop_z = float(section(system.geometry, system.geometry.stop, np.array([radius]))[0, 0])
    for side in (1, -1):
        ends = side * np.array([radius, radius + 0.22 * unit])
        axes.plot([stop_z] * 2, ends, color=INK, linewidth=2.2, zorder=4, solid_capstyle="butt")
    # Below the stop and the glass that is there.
    beside = [e.outline[abs(e.outline[:, 0] - stop_z) < 0.2 * unit, 1] for e in glass]
    _under(axes, stop_z, min(-radius - 0.22 * unit, np.concatenate(beside).min(initial=0)), "stop")
    length = round_near(0.7 * unit, (1, 2, 5))
    at = low + 0.03 * unit
    axes.plot([at[0], at[0] + length], [at[1]] * 2, color=INK, linewidth=1.4, solid_capstyle="butt")
    axes.annotate(
        f"{length:g} mm",
        (at[0] + length / 2, at[1]),
        (0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=7.5,
    )


def legend(axes: Axes, handles: list[Line2D]) -> None:
    """Write the names of the fields above the layout."""
    axes.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.02),
        ncols=3,
        borderaxespad=0,
        borderpad=0,
    )


def _to_scale(axes: Axes, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Set limits that hold all points, with one scale in both directions; return the limits."""
    box = axes.get_position()
    size = np.array([box.width, box.height]) * axes.figure.get_size_inches()
    low, high = points.min(axis=0), points.max(axis=0)
    strip = np.array([0.0, 0.32])  # inches at the bottom for the scale bar
    scale = 1.02 * ((high - low) / (size - strip)).max()
    middle = (low + high) / 2 - scale * strip / 2
    low, high = (middle + side * scale * size / 2 for side in (-1, 1))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    return low, high


def _under(axes: Axes, x: float, y: float, text: str) -> None:
    axes.annotate(
        text,
        (x, y),
        (0, -3),
        textcoords="offset points",
        ha="center",
        va="top",
        fontsize=7.5,
        annotation_clip=False,
    )


def _mix(light: str, dark: str, part: float) -> tuple[float, ...]:
    first, second = (np.array(matplotlib.colors.to_rgb(colour)) for colour in (light, dark))
    return tuple(first + part * (second - first))
