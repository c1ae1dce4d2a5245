"""The validation of Shin et al. (Samsung and Ansys), with our engine and stand-in lenses.

The paper holds a simulated camera against a real one. Here the simulated one is held against
independent predictions of the same quantities: see the modules of each section.
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Any

import numpy as np

from gpusim.lens.system import build
from gpusim.validate import samsung_figures as figures
from gpusim.validate.at_once import Progress, at_once
from gpusim.validate.certified import certificate_bar, certificate_numbers, certificate_section
from gpusim.validate.predict import Predictor
from gpusim.validate.report import Report, Rows, Section
from gpusim.validate.samsung_camera import (
    LENSES,
    LINES_NM,
    STANDARD,
    Optics,
    lens_of,
    predictor_of,
)
from gpusim.validate.samsung_colour import PATCHES, Colours, measure_colours
from gpusim.validate.samsung_corners import Corners, measure_corners
from gpusim.validate.samsung_edges import Edges, measure_edges
from gpusim.validate.samsung_noise import EXPOSURES_S, ISOS, SIGNAL_BAR, Noise, measure_noise
from gpusim.validate.samsung_qe import CHANNELS, Efficiency, measure_qe
from gpusim.validate.tracers import SHARED, independence_bar

TITLE = "Validation: Samsung's digital twin of an image sensor"
PAPER = (
    "J. Shin, S. Kang, S. Kim, J. Kim, S. Noygues, J. Son, H. Choi, J. Lee, S.-S. Kim and Y. Kim, "
    "End-to-End CIS Digital Twin Using Lens Geometry Spectral Ray Tracing and Pixel Modeling"
)
TEXT = (
    "The paper publishes no prescriptions: the library's IMX477-like sensor stands behind three of "
    "its lenses, scaled so that their chief rays reach the sensor's corners at 106.8, "
    "50.3 and 14.7 degrees (a fisheye, a compact lens at f/2.8 and a telephoto lens), and there is "
    "no capture of a real camera: simulated pictures are held against predictions by rays of "
    "another program, and by equations."
)
NODES_NM = np.array([400.0, 500.0, 600.0, 700.0])  # of the rays: glass goes smoothly between


def validated(
    progress: Progress = lambda what, done, total: None,
    *,
    own: bool = False,
) -> Report:
    """Make the report: all that the paper shows, measured and predicted.

    Parameters
    ----------
    progress : callable
        Called with (what, done, total).
    own : bool
        Whether our tracer predicts, which is not independent.
    """
    parts = [*(partial(_lines, one) for one in LENSES), _efficiency, _colours, _noise]
    *lines, efficiency, colours, noise = at_once([partial(part, own) for part in parts], progress)
    edges, corners = zip(*lines, strict=True)
    return report(Edges.of(edges), Corners.of(corners), efficiency, colours, noise)


def _lines(optics: Optics, own: bool, progress: Progress) -> tuple[Edges, Corners]:
    """Return edges and corners of one lens, which share its rays."""
    return measure_edges(own, progress, [optics]), measure_corners(own, progress, [optics])


def _efficiency(own: bool, progress: Progress) -> Efficiency:
    progress("efficiency", 0, 1)
    found = measure_qe(lens_of(STANDARD), _predictor(own))
    progress("efficiency", 1, 1)
    return found


def _noise(own: bool, progress: Progress) -> Noise:
    progress("noise", 0, 1)
    found = measure_noise(lens_of(STANDARD), _predictor(own))
    progress("noise", 1, 1)
    return found


def _colours(own: bool, progress: Progress) -> Colours:
    """Return the colours, which no rays predict."""
    progress("colour", 0, 1)
    found = measure_colours(lens_of(STANDARD))
    progress("colour", 1, 1)
    return found


def _predictor(own: bool) -> Predictor:
    lens = lens_of(STANDARD)
    return predictor_of(build(lens), math.radians(lens.max_field_deg), NODES_NM, own=own)


def report(
    edges: Edges,
    corners: Corners,
    efficiency: Efficiency,
    colours: Colours,
    noise: Noise,
) -> Report:
    """Return the report of what was found."""
    parts = edges, corners, efficiency, colours, noise
    certificates = {name: one for part in parts for name, one in part.certificates.items()}
    bars = [
        independence_bar(edges.independent),
        *(bar for part in parts for bar in part.bars()),
        certificate_bar(certificates),
    ]
    sections = [
        edge_section(edges),
        corner_section(corners),
        efficiency_section(efficiency),
        colour_section(colours),
        noise_section(noise),
        certificate_section(certificates),
    ]
    numbers = {
        "edges": [
            {"lens": one.optics.name, "place": one.where, "nm": LINES_NM[one.channel],
             "error": one.error, "from_rays": one.from_rays}
            for one in edges.found
        ],
        "corners": [
            {"lens": one.optics.name, "place": one.where, "measured_px": one.measured,
             "predicted_px": one.predicted, "chief_ray_px": one.chief}
            for one in corners.found
        ],
        "efficiency": [dataclasses.asdict(one) for one in efficiency.places],
        "colour": colour_numbers(colours),
        "noise": [dataclasses.asdict(one) for one in noise.readings],
        "certificates": certificate_numbers(certificates),
    }  # fmt: skip
    text = f"{TEXT} Rays are those of {edges.tracer}. {SHARED}"
    who = edges.tracer, edges.independent
    return Report("samsung", TITLE, PAPER, text, bars, sections, numbers, *who)


def colour_numbers(colours: Colours) -> list[dict[str, Any]]:
    """Return every number of the patches."""
    return [
        {
            "patch": name,
            "developed_xy": colours.developed[k].tolist(),
            "truth_xy": colours.truth[k].tolist(),
            "chart_xy": colours.chart[k].tolist(),
            "miss": float(colours.misses[k]),
            "from_chart": float(colours.from_chart[k]),
        }
        for k, name in enumerate(colours.names)
    ]


def edge_section(edges: Edges) -> Section:
    """Return the section of the edge spread functions (figure 9 of the paper)."""
    text = (
        "The paper compares two programs' rays. The engine's light is a wave: it is held against "
        "the wave that an independent tracer's rays make (bar of the largest difference), from "
        "where chief rays land. What rays alone would show is drawn beside it; the table says how "
        "far it lies from the render."
    )
    body = [
        [f"{one.optics.full_deg:g}", one.where, f"{LINES_NM[one.channel]:g}",
         f"{one.error:.4f}", f"{one.from_rays:.4f}"]
        for one in edges.found
    ]  # fmt: skip
    head = ("lens [deg]", "place", "nm", "error", "from rays alone")
    title = "Edge spread functions, as figure 9 of the paper"
    return Section(title, text, "edges", figures.draw_edges(edges), Rows(head, body))


def corner_section(corners: Corners) -> Section:
    """Return the section of the corners of a checkerboard (distortion)."""
    seen = [one for one in LENSES if any(corner.optics == one for corner in corners.found)]
    rms = ", ".join(
        f"{corners.chief_rms_px(one):.3f} and {corners.rms_px(one):.4f} px ({one.name})"
        for one in seen
    )
    text = (
        "Where a corner of a checkerboard is found in the render, less where it is found in the "
        "picture that the tracer's rays predict there: chief rays, PSF and pixel. Coma moves "
        "corners by a pixel from their chief rays, which a comparison with chief rays alone would "
        "take for distortion; the last columns say by how much, measured and predicted. From chief "
        f"rays, and from there less the predicted shift, corners lie {rms}, RMS. Places end at "
        "0.75 of the half field: optiland aims at no more than 0.8 of a fisheye's."
    )
    body = [
        [f"{one.optics.full_deg:g}", one.where, *(f"{at:.1f}" for at in one.chief),
         *(f"{a - b:+.4f}" for a, b in zip(one.measured, one.predicted, strict=True)),
         f"{one.from_chief_px:.3f}", f"{one.shift_px:.3f}"]
        for one in corners.found
    ]  # fmt: skip
    head = (
        "lens [deg]", "place", "x [px]", "y [px]", "error x", "error y", "from chief ray",
        "predicted",
    )  # fmt: skip
    title = "Corners of a checkerboard, three lenses"
    return Section(title, text, "corners", figures.draw_corners(corners), Rows(head, body))


def efficiency_section(found: Efficiency) -> Section:
    """Return the section of quantum efficiency (figure 5 of the paper)."""
    text = (
        "The paper's map of the pixel is not published: the library's made-up one by angle stands "
        "in, behind micro-lenses that are shifted less than the lens asks for. Efficiencies are "
        "electrons over the photons of the scene's light that arrive at a pixel."
    )
    body = [
        [f"{one.x_mm:.2f}, {one.y_mm:.2f}", *(f"{one.measured[name]:.5f}" for name in CHANNELS),
         *(f"{one.measured[name] / one.predicted[name] - 1:+.1e}" for name in CHANNELS)]
        for one in found.places
    ]  # fmt: skip
    head = ("x, y [mm]", *CHANNELS, *CHANNELS)
    groups = (1, ""), (len(CHANNELS), "Rendered"), (len(CHANNELS), "Over direct averages, less 1")
    title = "Quantum efficiency by field, as figure 5 of the paper"
    rows = Rows(head, body, groups)
    return Section(title, text, "efficiency", figures.draw_efficiency(found), rows)


def colour_section(colours: Colours) -> Section:
    """Return the section of the patches (figures 12 and 13 of the paper)."""
    own = colours.from_chart[:PATCHES]
    farthest = colours.names[int(own.argmax())]
    text = (
        "LibRaw, dcraw's successor, develops the raw by its own black level, white balance and "
        "matrix, to XYZ. The truth is what reflectances, light, quantum efficiency and that "
        "matrix make of the patches by equations. From the chart's own colours the developed ones "
        f"lie {own.mean():.4f} on average and {own.max():.4f} at most ({farthest}), for the "
        "sensor's channels are no combination of the eye's: a matrix cannot do better. The paper "
        "explains such distances by its materials' BRDF."
    )
    body = [
        [name, *(f"{value:.4f}" for value in (*colours.developed[k], *colours.truth[k])),
         f"{colours.misses[k]:.4f}", f"{colours.from_chart[k]:.4f}"]
        for k, name in enumerate(colours.names[:PATCHES])
    ]  # fmt: skip
    head = ("patch", "x", "y", "x, truth", "y, truth", "from truth", "from the chart")
    title = "Chromaticity of the ColorChecker's patches, as figure 13 of the paper"
    return Section(title, text, "colour", figures.draw_colours(colours), Rows(head, body))


def noise_section(noise: Noise) -> Section:
    """Return the section of signal and noise (equations 2 and 3 of the paper)."""
    text = (
        "Electrons by the paper's equation 2 from the light of the scene, what glass surfaces pass "
        "and the pupil's projected solid angle; numbers by its equation 3; and the temporal "
        "signal-to-noise ratio of EMVA 1288. Saturated readings have the full well or the top code "
        "of these equations, and no ratio; those of which some pixels saturate are left out. The "
        "table has the signal's error and what is allowed of it, percent, in the channel where it "
        f"is the largest part: {100 * SIGNAL_BAR:g} %, and what chance leaves of so many pixels."
    )
    body = []
    for iso in ISOS:
        worst = [noise.worst(iso, exposure_s) for exposure_s in EXPOSURES_S]
        cells = (
            "-" if one is None else f"{100 * one.signal_error:+.3f} of {100 * one.allowance:.3f}"
            + (", saturated" if one.snr is None else "")
            for one in worst
        )  # fmt: skip
        body.append([str(iso), *cells])
    head = ("ISO", *(f"1/{1 / exposure_s:g} s" for exposure_s in EXPOSURES_S))
    title = "Signal and SNR by exposure and ISO"
    return Section(title, text, "noise", figures.draw_noise(noise), Rows(head, body))
