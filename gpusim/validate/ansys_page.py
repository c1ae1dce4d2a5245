"""The Ansys and Meta report: its numbers, figures and tables."""

from __future__ import annotations

import dataclasses
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from gpusim.metrics.sfr import FREQUENCIES_CY_PX
from gpusim.report.drawing import INK, SOFT, STYLE, panel, titles
from gpusim.validate.ansys import (
    CENTRAL,
    LGD_BAR,
    MEAN_LGD,
    OBJECT_M,
    TOLERANCE,
    Read,
    bars,
)
from gpusim.validate.ansys_electrons import EvenScene
from gpusim.validate.ansys_models import CENTRE_NM, PAPER_F_NUMBER
from gpusim.validate.ansys_mtf import REALISATIONS, Sharpness
from gpusim.validate.ansys_mtf_figures import draw_curves, draw_focus, draw_models, draw_noise
from gpusim.validate.ansys_square import LAMP as EDGES_LAMP
from gpusim.validate.ansys_square import TOLERANCE as EDGES_TOLERANCE
from gpusim.validate.ansys_tables import edges, electrons, losses, models, noises, openings
from gpusim.validate.ansys_targets import HEIGHT_MM, LAMP, LUMINANCE_CD_M2
from gpusim.validate.certified import Certified, certificate_numbers, certificate_section
from gpusim.validate.report import Report, Rows, Section
from gpusim.validate.tracers import SHARED

TITLE = "Validation: Ansys' and Meta's camera of an AR/VR headset"
PAPER = (
    "End-to-end sensor system modeling and validation for AR/VR/MR applications (Ansys; Meta "
    "Reality Labs): sections 1.2, 2.2 and 3"
)
TEXT = (
    "Predictions are by rays through the lens's surfaces in NumPy (gpusim.validate.spheres). "
    f"{SHARED} The unit of the target's plane is the engine's too: no bar depends on it. "
    "The paper contradicts itself: "
    "section 1.2 has a focal length of 3 mm and pixels of 1.98 um, section 2.2 has 1.061 mm and "
    "3.96 um. Both are run, the second on the middle 320 x 320 pixels, the part of the sensor that "
    "the height of the paper's chart of 50.3 x 33.5 in at 60 cm fills: that is 71 deg, its width "
    "94 deg. The paper publishes no prescription: a fisheye takes the lens's place, its 64 deg "
    "read as the half field, for 32 deg would light a third of the sensor at 1.061 mm, and three "
    "fifths of the chart's width. Its distortion is then nearly the paper's: the mean over the "
    "central 40 % of the way to the corner of 2.534 x 2.534 mm is {mean:.2f} %, the "
    f"paper's {MEAN_LGD:g} %. At 3 mm no lens has that: the same part of the sensor ends 6.8 deg "
    "from the axis, where even an orthographic fisheye has -0.23 % on the average, the stand-in "
    "{other:.2f} %. The paper's figure thus speaks for section 2.2. "
    f"Targets are {OBJECT_M:g} m away, their white at {LUMINANCE_CD_M2:g} cd/m^2. Checkerboard and "
    f"waves are lit by {LAMP}, which is known to 830 nm; edges by a blackbody, {EDGES_LAMP} as the "
    "paper's panels, and seen from 400 to 1100 nm. The renders are planned for a tolerance of "
    f"{TOLERANCE:g} of the signal, those of edges for {EDGES_TOLERANCE:g}, and their certificates "
    "say what they keep."
)
FITS = {"3rd order": "#c0342b", "5th order": "#1b8a6b", "tangent": "#2456b8"}
PERIODS = {3: "#2456b8", 4: "#c0342b", 5: "#b8860b"}  # blue, red, yellow as in figure 10


def report(found: list[Read], sharp: list[Sharpness], even: EvenScene) -> Report:
    """Return the report: distortion and waves of all readings, sharpness, and an even scene."""
    sections = [
        Section(
            "Distortion against the lens's own data, as figure 8 of the paper.",
            "LGD = (r_d - r_u) / r_u of the corners of a checkerboard, at each distance from the "
            "middle up to the outermost corner, and of the centroids of rays of all wavelengths. "
            "Corners scatter by the chosen model's residual. The three models are fitted to the "
            "same corners; as in the paper, none follows the lens everywhere.",
            "distortion",
            draw_distortion(found),
            _fits(found),
        ),
        Section(
            "Spatial frequency content, as figure 10 of the paper.",
            f"Transforms of the middle rows over the central {100 * CENTRAL:g} % of the width, "
            "under a Hann window. Predicted is the same wave where rays of all wavelengths put "
            "it. The paper's place is the target's frequency over one plus the mean LGD there.",
            "frequencies",
            draw_frequencies(found),
            _peaks(found),
        ),
        *_sharpness(sharp, [one.chart for one in found]),
        Section(
            "Electrons by equation 1.",
            "An even scene's electrons at places of the picture at 1.061 mm. The efficiency is the "
            "map's mean over the rays that arrive. Predicted are rays, less the light that "
            "diffraction bends over the rim of the lens's field, by a closed form "
            "(gpusim.validate.ansys_electrons): nothing from beyond the rim makes it good.",
            rows=electrons(even),
        ),
        certificate_section(_certificates(found, sharp, even)),
    ]
    tracer = found[0].lens.tracer
    who = tracer.name, tracer.independent
    return Report(
        "ansys",
        TITLE,
        PAPER,
        TEXT.format(mean=found[0].mean_lgd, other=found[-1].mean_lgd),
        [*bars(found), *(bar for one in sharp for bar in one.bars()), *even.bars()],
        sections,
        numbers(found)
        | {"sharpness": [_sharp_numbers(one) for one in sharp], "even_scene": _even_numbers(even)},
        *who,
    )


def _certificates(
    found: list[Read], sharp: list[Sharpness], even: EvenScene
) -> dict[str, Certified]:
    """Return the certificates of all renders."""
    readings = {
        f"{name}, {one.reading.name}": certificate
        for one in (*found, *sharp)
        for name, certificate in one.certificates.items()
    }
    return readings | {"even scene": even.certificate}


def _sharpness(sharp: list[Sharpness], charts: list[np.ndarray]) -> list[Section]:
    return [
        Section(
            "Electron map and MTF, as figures 11 and 15 of the paper.",
            f"The library's eSFR chart, {HEIGHT_MM:g} mm high at {OBJECT_M:g} m, in steps of 2:1. "
            "Where it has a star the paper's edition has a square, turned by 5 degrees, which "
            "is put there, and patches are left out, for colours are known to 730 nm alone; ROI 1 "
            "is its upper edge, ROI 3 its right one. At 3 mm the sensor sees "
            "30 % of the chart's height. The electron map goes by equation 1 with a map of "
            "efficiencies over wavelength, theta and phi of a simplified pixel "
            "(gpusim.validate.ansys_pixel); the irradiance map, at 1.061 mm alone, weighs light by "
            "its energy. "
            "Predicted are the pupil's transfer function by rays, all colours about their own "
            "chief rays, and the pixel's two sincs. Rays alone and the diffraction limit are those "
            "of the lens without a pixel. Sampling Q is the paper's equation 4 at "
            f"{CENTRE_NM:g} nm, 2 lambda N over the pitch; the area is that under the SFR to 1 "
            "cycle/px over that of the diffraction limit.",
            "mtf",
            draw_curves(sharp, charts),
            edges(sharp),
        ),
        Section(
            "Noise of the SFR, as figures 12 and 13 of the paper.",
            f"{REALISATIONS} frames of the electron map at 60 % of the full well, with shot and "
            "read noise in place of the paper's noise of a Monte Carlo method. The closed form "
            "(gpusim.validate.ansys_noise) follows from the pixels' mean electrons, their places "
            "and the read noise alone, by the delta method. Judged are frequencies so far apart "
            "that its correlations are small; all together their mean variance is held against "
            "the interval of chi-square with the degrees of freedom that the correlations leave.",
            "noise",
            draw_noise(sharp),
            noises(sharp),
        ),
        Section(
            "Through focus, as figure 14 of the paper.",
            "The image plane is moved and the lens prepared anew, in a map of irradiance; "
            "predicted by rays to the moved plane. At 3 mm by rays alone.",
            "focus",
            draw_focus(sharp),
            losses(sharp),
        ),
        Section(
            "What a reduced-order model costs.",
            "The paper finds that its model takes coma and astigmatism as a Gaussian and has no "
            "chromatic aberrations. The Gaussian has the rays' variance along the edge's normal, "
            f"over the diffraction limit; without colour all light has {CENTRE_NM:g} nm.",
            "models",
            draw_models(sharp),
            models(sharp),
        ),
        Section(
            f"Why f/2.88: the stand-in opened to the paper's f/{PAPER_F_NUMBER:g}.",
            "Spots by rays, in best focus. Its own glass stops a beam of f/2 on its way; larger "
            "glass passes it, with the spherical aberration that the design does not correct.",
            rows=openings(sharp),
        ),
    ]  # fmt: skip


def _even_numbers(even: EvenScene) -> dict[str, Any]:
    places = [dataclasses.asdict(place) for place in even.places]
    certificates = certificate_numbers({"even scene": even.certificate})
    return {"places": places, "certificates": certificates}


def _sharp_numbers(one: Sharpness) -> dict[str, Any]:
    return {
        "name": one.reading.name,
        "illuminant": EDGES_LAMP,
        "f_number": one.f_number,
        "q": one.q,
        "area": one.area,
        "frequencies_cy_px": FREQUENCIES_CY_PX.tolist(),
        "edges": [
            {
                "map": name, "roi": number, "place_error_px": edge.error_px,
                "measured_mtf": edge.measured_mtf.tolist(),
                "predicted_mtf": edge.predicted_mtf.tolist(),
            }
            for (name, number), edge in one.found.items()
        ],
        "noise": [
            {
                "roi": number, "sigma": noise.sigma.tolist(), "expected": noise.expected.tolist(),
                "judged": noise.judged.tolist(), "outside": noise.outside,
                "variance_over_closed_form": noise.ratios.tolist(),
            }
            for number, noise in one.noise.items()
        ],
        "focus": [
            {
                "shift_um": at.shift_um,
                "measured_mtf": None if at.measured is None else at.measured.tolist(),
                "predicted_mtf": at.predicted.tolist(),
            }
            for at in one.focus
        ],
        "models": {name: curve.tolist() for name, curve in one.models.items()},
        "opened": [dataclasses.asdict(way) for way in one.opened],
        "certificates": certificate_numbers(one.certificates),
    }  # fmt: skip


def _fits(found: list[Read]) -> Rows:
    rows = []
    for one in found:
        for name, fit in one.distortion.fits.items():
            given = 100 * (fit.lgd(one.radii) - one.lens.lgd(one.radii * one.corner_mm))
            worst = np.abs(given).max()
            rows.append([
                one.reading.name, name, f"{fit.rms_px:.4f}", f"{fit.worst_px:.4f}", f"{worst:.3f}",
            ])  # fmt: skip
    head = "reading", "model", "RMS residual [px]", "worst [px]", "LGD off by [% points]"
    return Rows(head, rows)


def _peaks(found: list[Read]) -> Rows:
    rows = []
    for one in found:
        half_mm = CENTRAL * one.corner_mm / np.sqrt(2)
        shrunk = 1 + one.lens.mean_lgd(half_mm)
        for peak in one.peaks:
            paper = 1 / peak.period_px / shrunk
            rows.append([
                one.reading.name, f"1/{peak.period_px}", f"{peak.measured_cy_px:.5f}",
                f"{peak.predicted_cy_px:.5f}", f"{peak.error:+.3f}", f"{paper:.5f}",
            ])  # fmt: skip
    head = (
        "reading", "target [cycles/px]", "measured", "predicted", "error [%]", "by the mean LGD",
    )  # fmt: skip
    return Rows(head, rows)


def numbers(found: list[Read]) -> dict[str, Any]:
    """Return every number of the report."""
    return {
        "object_m": OBJECT_M,
        "illuminant": LAMP,
        "luminance_cd_m2": LUMINANCE_CD_M2,
        "tolerance": TOLERANCE,
        "paper_mean_lgd_percent": MEAN_LGD,
        "readings": [_numbers(one) for one in found],
    }


def _numbers(one: Read) -> dict[str, Any]:
    radii = one.radii
    return {
        "name": one.reading.name,
        "efl_mm": one.reading.efl_mm,
        "pitch_um": one.reading.pitch_um,
        "pixels": one.reading.pixels,
        "mean_lgd_percent": one.mean_lgd,
        "marks": len(one.distortion.marks.x),
        "radius": radii.tolist(),
        "lens_lgd_percent": (100 * one.lens.lgd(radii * one.corner_mm)).tolist(),
        "lgd_error_points": one.lgd_errors.tolist(),
        "fits": {
            name: {
                "coefficients": fit.coefficients.tolist(),
                "rms_px": fit.rms_px,
                "worst_px": fit.worst_px,
                "lgd_percent": (100 * fit.lgd(radii)).tolist(),
            }
            for name, fit in one.distortion.fits.items()
        },
        "peaks": [
            {
                "period_px": peak.period_px,
                "measured_cy_px": peak.measured_cy_px,
                "predicted_cy_px": peak.predicted_cy_px,
                "error_percent": peak.error,
            }
            for peak in one.peaks
        ],
        "certificates": certificate_numbers(one.certificates),
    }


def draw_distortion(found: list[Read]) -> Figure:
    """Return checkerboards, LGD over the radius, and what the measured one misses."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 0.6 + 3.5 * len(found)))
        told = "line: rays through the lens; dots: corners of the checkerboard; dashed: models"
        titles(figure, "Local geometric distortion", [told], top=0.55 + 3.5 * len(found))
        for row, one in enumerate(found):
            bottom = 0.5 + 3.5 * (len(found) - 1 - row)
            board = panel(figure, 0.45, bottom, 2.4, 2.4)
            board.imshow(one.board, cmap="gray", interpolation="nearest")
            board.grid(False)
            board.set(title=one.reading.name, xticks=[], yticks=[])
            axes, rest = panel(figure, 3.6, bottom, 3.9, 2.4), panel(figure, 8.2, bottom, 2.7, 2.4)
            r = one.radii
            axes.plot(r, 100 * one.lens.lgd(r * one.corner_mm), color=INK, label="lens data")
            dots = {"linestyle": "none", "marker": ".", "markersize": 3, "color": SOFT}
            marks = one.distortion
            off = marks.radius > r[0]  # in the middle LGD is 0 over 0
            axes.plot(marks.radius[off], 100 * marks.lgd[off], label="corners", **dots)
            for name, colour in FITS.items():
                curve = 100 * marks.fits[name].lgd(r)
                axes.plot(r, curve, color=colour, linestyle=(0, (4, 2)), label=name, linewidth=1)
            axes.set(title="LGD [%]", xlabel="r_d, from the middle to the corner")
            axes.legend(loc="lower left")
            rest.plot(r, one.lgd_errors, color=INK, marker=".", markersize=3)
            for bound in (-LGD_BAR, LGD_BAR):
                rest.axhline(bound, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
            rest.set(title="Measured less lens data [% points]", xlabel="r_d")
    return figure


def draw_frequencies(found: list[Read]) -> Figure:
    """Return spectra of the sinusoids over those of rays."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(0.6 + 5.4 * len(found), 4.4))
        told = "lines: renders; thin: rays of all wavelengths; dashed: the targets' frequencies"
        titles(figure, "Spectra of sinusoids", [told], top=4.35)
        for col, one in enumerate(found):
            axes = panel(figure, 0.7 + 5.4 * col, 0.65, 4.7, 2.4)
            for peak in one.peaks:
                colour = PERIODS[peak.period_px]
                axes.axvline(1 / peak.period_px, color=INK, linewidth=0.8, linestyle=(0, (4, 2)))
                f = peak.frequency_cy_px
                axes.plot(f, peak.spectrum, color=colour, label=f"1/{peak.period_px} cycles/px")
                axes.plot(f, peak.predicted, color=INK, linewidth=0.6)
            axes.set(title=one.reading.name, xlim=(0.1, 0.5), ylim=(0, 1.05))
            axes.set(xlabel="cycles per pixel", ylabel="of the largest" if col == 0 else "")
            axes.legend(loc="upper right")
    return figure
