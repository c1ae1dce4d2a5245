"""One page on a lens: layout, PSFs, MTF, through focus, distortion, colour, illumination."""

from __future__ import annotations

import io

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator
from scipy import ndimage
from scipy.interpolate import PchipInterpolator

from gpusim.lens import transfer
from gpusim.lens.bank import Bank
from gpusim.lens.layout import Element, section
from gpusim.lens.plane_bank import PlaneBank
from gpusim.lens.system import System
from gpusim.report.lens_facts import distortions, lens_facts, ready_facts, working_f_number
from gpusim.report.lens_page import (
    CURVE_FIELDS,
    BankPage,
    LensPage,
    field_light,
    field_number,
    round_above,
    round_near,
)
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, encode_srgb, rgb_to_xyz
from gpusim.scene.spectra import WAVELENGTHS_NM, colour_matching

# Axis, half and full field: even in lightness, told apart by all kinds of colour vision (from
# ColorBrewer's PuOr), and none of them the colour of a wavelength that is shown.
FIELD_COLOURS = dict(zip(CURVE_FIELDS, ("#1b1f24", "#d9730d", "#6a3fa0"), strict=True))
# Parts of the largest field, by the bank's fields.
PSF_FIELDS = (0.0, 0.25, 0.5, 0.75, 1.0)
PSF_WAVELENGTHS_NM = (450.0, 550.0, 650.0)
# Decades of the PSFs' logarithmic stretch: down to Airy's third ring, 1.6e-3 of the peak.
DECADES = 3.0
# Share of the light that the pictures of the PSFs hold in the widest of them.
PSF_SHARE = 0.85
DPI = 160

# colours


def wavelength_colour(wavelength_nm: float, luminance: float = 0.2) -> tuple[float, float, float]:
    """Return the sRGB colour of a wavelength, no lighter than reads on white paper."""
    xyz = [np.interp(wavelength_nm, WAVELENGTHS_NM, curve) for curve in colour_matching()]
    to_xyz = rgb_to_xyz(REC709_CHROMATICITIES)
    linear = np.maximum(np.linalg.solve(to_xyz, xyz), 0)
    linear /= linear.max()
    return tuple(encode_srgb(linear * min(1.0, luminance / (to_xyz[1] @ linear))).tolist())


def colour_image(psf: np.ndarray, bank: Bank | PlaneBank) -> np.ndarray:
    """Return a polychromatic PSF in its colours, white where all wavelengths have their share.

    Parameters
    ----------
    psf : ndarray, shape (L, n, n)
        Light of each wavelength.
    bank : Bank or PlaneBank

    Returns
    -------
    ndarray, shape (n, n, 3)
        sRGB; the brightness is stretched, the ratios of the colours are not.
    """
    matching = [
        np.interp(bank.wavelengths_nm, WAVELENGTHS_NM, curve) for curve in colour_matching()
    ]
    to_rgb = np.linalg.solve(rgb_to_xyz(REC709_CHROMATICITIES), matching)
    linear = np.tensordot(to_rgb, psf, 1)
    linear = np.maximum(linear / linear.sum(axis=(1, 2), keepdims=True), 0)
    bright = linear.max(axis=0)
    shown = stretched(bright / bright.max())
    ratio = encode_srgb(linear / np.maximum(bright, 1e-30))
    return np.moveaxis(ratio * shown, 0, -1)


def stretched(share: np.ndarray) -> np.ndarray:
    """Return the logarithmic stretch of light as a share of the peak: 0 to 1 over DECADES."""
    return 1 + np.log10(np.maximum(share, 10**-DECADES)) / DECADES


# the figure


def draw(page: LensPage, *, titled: bool = True) -> Figure:
    """Return the page as a figure, with its title or without."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 13.4 if titled else 12.6))
        if titled:
            head(figure, page.bank, top=13.4)
        layout = panel(figure, 0.55, 9.45, 6.45, 2.65)
        draw_layout(layout, page.system, page.elements, page.beams, page.bank.image_circle_um)
        legend(layout, _field_handles(page, full=True))
        facts(figure, lens_facts(page.bank, page.system), left=7.55, top=12.35, width=4.05)
        draw_psfs(figure, page.bank, left=0.8, top=8.88, cell=1.17)
        draw_mtf(panel(figure, 7.75, 6.85, 3.85, 2.0), page)
        draw_focus(panel(figure, 7.75, 4.0, 3.85, 2.0), page)
        draw_distortion(panel(figure, 0.8, 0.95, 2.55, 2.2), page)
        draw_colour(panel(figure, 4.65, 0.95, 2.55, 2.2), page)
        draw_light(panel(figure, 8.55, 0.95, 2.55, 2.2), page, "traced")
        write(figure, 0.55, 0.28, FOOT, fontsize=7, color=SOFT, va="center")
    return figure


def draw_ready(page: BankPage, *, titled: bool = True) -> Figure:
    """Return the page of a bank without a prescription: what it has no data for is said."""
    bank = page.bank
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 10.6 if titled else 9.8))
        if titled:
            head(figure, bank, top=10.6)
        facts(figure, ready_facts(bank), left=7.55, top=9.3, width=4.05)
        draw_psfs(figure, bank, left=0.8, top=8.88, cell=1.17)
        draw_mtf(panel(figure, 7.75, 4.0, 3.85, 2.0), page, fields=True)
        draw_distortion(panel(figure, 0.8, 0.95, 2.55, 2.2), page)
        colour = panel(figure, 4.65, 0.95, 2.55, 2.2)
        if len(page.chief_nm) > 1:
            draw_colour(colour, page)
        else:
            absent(colour, "Lateral colour", "the bank has one wavelength")
        draw_light(panel(figure, 8.55, 0.95, 2.55, 2.2), page, "bank")
        write(figure, 0.55, 0.42, READY_FOOT, fontsize=7, color=SOFT, va="center")
        write(figure, 0.55, 0.2, READY_ABSENT, fontsize=7, color=SOFT, va="center")
    return figure


def png(figure: Figure) -> bytes:
    """Return a page as a PNG file."""
    return _rendered(figure, "png")


def svg(figure: Figure) -> str:
    """Return a page as SVG, letters as outlines: it looks the same anywhere."""
    metadata = {"Date": None, "Creator": None}
    return _rendered(figure, "svg", metadata=metadata).decode()


def _rendered(figure: Figure, form: str, **options: object) -> bytes:
    file = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "gpusim", "svg.fonttype": "path"}):
        figure.savefig(file, format=form, dpi=DPI, **options)
    return file.getvalue()


INK, SOFT, LINE = "#1b1f24", "#5d6773", "#c9ced6"
STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 7,
    "axes.labelsize": 8.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": LINE,
    "grid.linewidth": 0.5,
    "grid.alpha": 0.7,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "text.color": INK,
    "mathtext.default": "regular",
}
FOOT = (
    "Tangential: spatial frequency along the radius. Sagittal: across it. Polychromatic: equal "
    "energy per nm, times the lens's transmission and pupil, chief rays where they land. "
    "Diffraction and aberrations from real rays."
)


READY_FOOT = (
    "Tangential: spatial frequency along the radius. Sagittal: across it. Polychromatic: equal "
    "energy per nm, times the bank's transmission and solid angle, chief rays where they land. MTF "
    "of the PSFs in the bank."
)
READY_ABSENT = (
    "Not drawn, because a bank does not hold it: the layout with its rays (no surfaces), and the "
    "MTF through focus (one image plane)."
)


def panel(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Return axes at a place in inches."""
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def write(figure: Figure, left: float, bottom: float, text: str, **style: object) -> None:
    """Write a text at a place in inches."""
    across, up = figure.get_size_inches()
    figure.text(left / across, bottom / up, text, **style)


def absent(axes: Axes, title: str, why: str) -> None:
    """Say in a panel what it would show, and why it does not."""
    axes.set(title=title, xticks=[], yticks=[])
    axes.grid(False)
    axes.spines[:].set_color(LINE)
    axes.text(0.5, 0.5, why, color=SOFT, ha="center", va="center", transform=axes.transAxes)


def head(figure: Figure, bank: Bank, top: float) -> None:
    """Write what the lens is."""
    order = [f"f = {bank.efl_mm:.4g} mm", f"f/{bank.f_number:.3g}"]
    order.append(f"{2 * bank.field_deg[-1]:.4g}\N{DEGREE SIGN} full field")
    order.append(f"{bank.wavelengths_nm[0]:g} to {bank.wavelengths_nm[-1]:g} nm")
    if bank.provenance.get("patent", "none") != "none":
        order.append(bank.provenance["patent"])
    titles(figure, bank.provenance["title"], order, top)


def titles(figure: Figure, title: str, order: list[str], top: float) -> None:
    """Write the title of a page, and the line below it."""
    write(figure, 0.55, top - 0.42, title, fontsize=15, fontweight="bold", va="center")
    line = "   \N{MIDDLE DOT}   ".join(order)
    write(figure, 0.55, top - 0.74, line, fontsize=9, color=SOFT, va="center")


def facts(
    figure: Figure, rows: list[tuple[str, str]], left: float, top: float, width: float
) -> None:
    """Write names and texts as a table."""
    step = 2.75 / len(rows)
    for row, (name, text) in enumerate(rows):
        up = top - row * step
        write(figure, left, up, name, fontsize=7.8, color=SOFT, va="center")
        write(figure, left + width, up, text, fontsize=7.8, va="center", ha="right")
        if row:
            across, tall = figure.get_size_inches()
            figure.add_artist(
                Line2D(
                    [left / across, (left + width) / across],
                    [(up + step / 2) / tall] * 2,
                    color=LINE,
                    linewidth=0.4,
                )
            )


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
    for paths, colour in zip(beams, FIELD_COLOURS.values(), strict=True):
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


def _field_handles(page: BankPage, *, full: bool = False) -> list[Line2D]:
    """Return legend entries of the fields that have curves."""
    return [
        Line2D(
            [],
            [],
            color=FIELD_COLOURS[curves.name],
            label=_field_label(curves.name, curves.field_deg) if full else curves.name,
        )
        for curves in page.curves
    ]


def _mix(light: str, dark: str, part: float) -> tuple[float, ...]:
    first, second = (np.array(matplotlib.colors.to_rgb(colour)) for colour in (light, dark))
    return tuple(first + part * (second - first))


def _field_label(name: str, field_deg: float) -> str:
    return name if field_deg == 0 else f"{name} ({field_deg:.3g}\N{DEGREE SIGN})"


def draw_psfs(figure: Figure, bank: Bank, left: float, top: float, cell: float) -> None:
    """Draw PSFs over field (columns) and wavelength (rows), all to one scale."""
    fields = sorted({field_number(bank, part) for part in PSF_FIELDS})
    nearest = {int(np.abs(bank.wavelengths_nm - w).argmin()) for w in PSF_WAVELENGTHS_NM}
    lines = sorted(nearest)
    half_um = _psf_half_um(bank, fields)
    gap = 0.05
    rows = len(lines) + (len(lines) > 1)  # and all of them together
    bottom = top - rows * (cell + gap)
    for column, field in enumerate(fields):
        light = field_light(bank, field)
        shift = bank.real_height_um[field] - bank.real_height_um[field, bank.reference]
        white = np.stack(
            [
                weight * ndimage.shift(psf.astype(float), (0, by / bank.pitch_um), order=1)
                for weight, psf, by in zip(light, bank.psf[field], shift, strict=True)
            ]
        )
        for row in range(rows):
            axes = panel(
                figure,
                left + column * (cell + gap),
                bottom + (rows - 1 - row) * (cell + gap),
                cell,
                cell,
            )
            if row < len(lines):
                psf = bank.psf[field, lines[row]].astype(float)
                share = stretched(psf / psf.max())
                tones = _tones(bank.wavelengths_nm[lines[row]])
                image = tones(share)[..., :3]
            else:
                image = colour_image(white, bank)
            psf_image(axes, image, bank.pitch_um, half_um)
            if row == 0:
                angle = f"{bank.field_deg[field]:.3g}\N{DEGREE SIGN}"
                axes.set_title(angle, loc="center", fontsize=8.5, fontweight="normal", pad=3)
            if column == 0:
                label = f"{bank.wavelengths_nm[0]:g}\N{EN DASH}{bank.wavelengths_nm[-1]:g} nm"
                if row < len(lines):
                    label = f"{bank.wavelengths_nm[lines[row]]:g} nm"
                axes.set_ylabel(label, labelpad=3)
            if (row, column) == (rows - 1, 0):
                psf_bar(axes, half_um)
    up = top + 0.33
    write(figure, left, up, "Point spread", fontsize=9.5, fontweight="bold")
    note = f"log stretch over {DECADES:g} decades, each to its own peak; the radius points up"
    write(figure, left + 1.1, up, note, fontsize=7.5, color=SOFT)


def _tones(wavelength_nm: float) -> LinearSegmentedColormap:
    """Return a scale from black over the colour of a wavelength to white."""
    colour = np.array(wavelength_colour(wavelength_nm, 0.4))
    return LinearSegmentedColormap.from_list(
        "", [(0.0, "#000000"), (0.6, tuple(0.08 + 0.92 * colour)), (1.0, "#ffffff")]
    )


def _psf_half_um(bank: Bank, fields: list[int]) -> float:
    """Return half the side of the pictures: round, and the widest PSF has PSF_SHARE within.

    The share is that of the light in the window.
    """
    n = bank.psf.shape[-1]
    at = (np.arange(n) - n // 2) * bank.pitch_um
    radius = np.maximum(np.abs(at)[:, None], np.abs(at)[None]).ravel()
    order = np.argsort(radius, kind="stable")
    mean = bank.psf[fields].mean(axis=1, dtype=float).reshape(len(fields), -1)[:, order]
    within = np.cumsum(mean, axis=1)
    needed = max(radius[order][np.searchsorted(line, PSF_SHARE * line[-1])] for line in within)
    return min(round_above(needed), n // 2 * bank.pitch_um)


def psf_image(axes: Axes, image: np.ndarray, pitch_um: float, half_um: float) -> None:
    """Show a picture (eta, xi, 3) with the radius pointing up."""
    half = len(image) / 2 * pitch_um
    extent = np.array([-half, half, -half, half]) - pitch_um / 2
    axes.imshow(
        image.transpose(1, 0, 2),
        extent=extent,
        origin="lower",
        interpolation="bicubic",
        aspect="equal",
    )
    axes.set(xlim=(-half_um, half_um), ylim=(-half_um, half_um), xticks=[], yticks=[])
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def psf_bar(axes: Axes, half_um: float) -> None:
    """Draw a scale into a picture of a PSF."""
    length = round_near(0.7 * half_um, (1, 2, 5))
    x, y = -0.88 * half_um, -0.86 * half_um
    axes.plot([x, x + length], [y, y], color="white", linewidth=1.6, solid_capstyle="butt")
    axes.annotate(
        f"{length:g} \N{MICRO SIGN}m",
        (x + length / 2, y),
        (0, 3),
        textcoords="offset points",
        color="white",
        ha="center",
        va="bottom",
        fontsize=7.5,
    )


_DASHES = {"tangential": "-", "sagittal": (0, (4, 2))}


def draw_mtf(axes: Axes, page: BankPage, *, fields: bool = False) -> None:
    """Draw the polychromatic MTF of a few fields and the diffraction limit.

    ``fields`` asks for their names in the panel.
    """
    axes.plot(page.frequency, page.limit, color="#9aa3ad", linewidth=1.1, linestyle=":")
    for field in page.curves:
        _pair(axes, page.frequency, field.against_frequency, FIELD_COLOURS[field.name])
    axes.set(
        title="MTF",
        xlabel="spatial frequency [cycles/mm]",
        xlim=(0, page.frequency[-1]),
        ylim=(0, 1),
    )
    handles = [
        Line2D([], [], color=INK, label="tangential"),
        Line2D([], [], color=INK, linestyle=_DASHES["sagittal"], label="sagittal"),
        Line2D([], [], color="#9aa3ad", linestyle=":", label="diffraction limit"),
    ]
    if fields:
        names = axes.legend(handles=_field_handles(page, full=True), loc="upper right")
        axes.add_artist(names)
    axes.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
        borderaxespad=0,
        columnspacing=1.0,
        handlelength=1.8,
        handletextpad=0.5,
    )


def _pair(axes: Axes, x: np.ndarray, pair: np.ndarray, colour: str) -> None:
    for values, direction in zip(pair, transfer.DIRECTIONS, strict=True):
        axes.plot(x, values, color=colour, linestyle=_DASHES[direction], linewidth=1.3)


def draw_focus(axes: Axes, page: LensPage) -> None:
    """Draw the MTF through focus at one frequency."""
    in_um = page.focus_mm[-1] < 0.5
    factor, unit = (1e3, "\N{MICRO SIGN}m") if in_um else (1.0, "mm")
    axes.axvline(0, color=SOFT, linewidth=0.7)
    for pair, colour in zip(page.through_focus, FIELD_COLOURS.values(), strict=True):
        _pair(axes, factor * page.focus_mm, pair, colour)
    axes.set(
        title="Through focus",
        ylabel=f"MTF at {page.focus_frequency:g} cycles/mm",
        xlabel=f"shift of the image plane, away from the lens [{unit}]",
        xlim=(factor * page.focus_mm[0], factor * page.focus_mm[-1]),
        ylim=(0, 1),
    )
    axes.xaxis.set_major_locator(MaxNLocator(7))
    axes.legend(
        handles=_field_handles(page),
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
        borderaxespad=0,
        columnspacing=0.9,
        handlelength=1.0,
        handletextpad=0.4,
    )


def _against_field(axes: Axes, bank: Bank) -> None:
    axes.set(xlabel="field angle [\N{DEGREE SIGN}]", xlim=(0, bank.field_deg[-1]))
    axes.xaxis.set_major_locator(MaxNLocator(6))


def draw_distortion(axes: Axes, page: BankPage) -> None:
    """Draw the distortion against f tan(theta), and against f theta for wide lenses."""
    curves = distortions(page.chief_deg, page.chief_um[:, 0])
    axes.axhline(0, color=SOFT, linewidth=0.7)
    for percent, style in zip(curves.values(), _DASHES.values(), strict=False):
        axes.plot(page.chief_deg, percent, color=INK, linestyle=style)
    axes.set(title="Distortion", ylabel="%")
    _against_field(axes, page.bank)
    _roomy(axes)
    _end_labels(axes, [(float(percent[-1]), name, INK) for name, percent in curves.items()])


def draw_colour(axes: Axes, page: BankPage) -> None:
    """Draw where the chief rays of a few wavelengths land beside that of the reference."""
    bank = page.bank
    airy = 1.22e-3 * bank.reference_nm * working_f_number(bank)
    axes.axhspan(-airy, airy, color="#eceff3", linewidth=0, zorder=0)
    ends = []
    for line, wavelength in enumerate(page.chief_nm):
        shift, colour = page.chief_um[:, line] - page.chief_um[:, 0], wavelength_colour(wavelength)
        axes.plot(page.chief_deg, shift, color=colour)
        ends.append((float(shift[-1]), f"{wavelength:g} nm", colour))
    axes.set(title="Lateral colour", ylabel="\N{MICRO SIGN}m")
    _against_field(axes, bank)
    _roomy(axes)
    _end_labels(axes, ends)
    note = f"grey: Airy radius, {airy:.2g} \N{MICRO SIGN}m"
    axes.set_title(note, loc="right", fontsize=7.5, fontweight="normal", color=SOFT)


def draw_light(axes: Axes, page: BankPage, name: str) -> None:
    """Draw the relative illumination beside the cos^4 law."""
    bank = page.bank
    traced = bank.relative_illumination[:, bank.reference]
    fine = np.linspace(0, bank.field_deg[-1], 200)
    axes.plot(fine, _cos4(fine), color="#9aa3ad", linestyle=":")
    # Dots where it was computed; the curve between them keeps them and swings nowhere.
    axes.plot(fine, PchipInterpolator(bank.field_deg, traced)(fine), color=INK)
    axes.plot(bank.field_deg, traced, ".", color=INK, markersize=3.5, clip_on=False)
    axes.set(title="Relative illumination", ylim=(0, 1.02))
    _against_field(axes, bank)
    _end_labels(
        axes,
        [
            (float(traced[-1]), name, INK),
            (float(_cos4(fine[-1])), "cos$^4$", SOFT),
        ],
    )


def _cos4(field_deg: np.ndarray) -> np.ndarray:
    return np.cos(np.radians(np.minimum(field_deg, 90.0))) ** 4


def _roomy(axes: Axes) -> None:
    """Give curves that end at a border some room, and flat ones a scale."""
    low, high = axes.dataLim.intervaly
    low, high = min(low, 0.0), max(high, 0.0)
    pad = 0.08 * (high - low) if high - low > 1e-4 else 0.5
    axes.set_ylim(low - pad, high + pad)


def _end_labels(axes: Axes, ends: list[tuple[float, str, object]]) -> None:
    """Write names beside the right ends of curves, apart from one another."""
    low, high = axes.get_ylim()
    height = axes.get_position().height * axes.figure.get_size_inches()[1] * 72  # points
    need = 10.0 / height * (high - low)
    ends = sorted(ends, key=lambda end: end[0])
    at = np.array([end[0] for end in ends])
    for _ in range(100):  # push neighbours apart until all have room
        close = np.maximum(need - np.diff(at), 0)
        if close.max(initial=0) < 1e-3 * need:
            break
        at[:-1] -= close / 2
        at[1:] += close / 2
        at += max(low - at[0], 0) - max(at[-1] - high, 0)
    for y, (_, name, colour) in zip(at, ends, strict=True):
        axes.annotate(
            name,
            (1, (y - low) / (high - low)),
            (4, 0),
            xycoords="axes fraction",
            textcoords="offset points",
            va="center",
            fontsize=7.5,
            color=colour,
            annotation_clip=False,
        )
