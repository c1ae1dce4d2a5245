"""A lens of Gaussians, lopsided in both directions, and what design programs would export of it."""

from pathlib import Path

import numpy as np

WAVELENGTHS_NM = (450.0, 550.0, 650.0)
IDEAL_MM = (0.0, 0.4, 0.8, 1.2)
EFL_MM = 5.0
FIELDS_DEG = np.degrees(np.arctan(np.array(IDEAL_MM) / EFL_MM))
ILLUMINATION = (1.0, 0.98, 0.93, 0.85)


def real_mm(ideal_mm, wavelength_nm):
    """Return where a chief ray lands: 2 % of barrel at the edge, and lateral colour."""
    ideal = np.asarray(ideal_mm, float)
    return ideal * (1 - 0.02 * (ideal / 1.2) ** 2) * (1 + 2e-5 * (wavelength_nm - 550))


def light(xi_um, eta_um, ideal_mm, wavelength_nm):
    """Return the PSF at distances from the chief ray, radial and tangential; of no norm.

    A quarter of the light lies up to 3 um outwards and 2 um along the tangent, which no centred
    lens does: so nothing that a mirror or a turn does can hide.
    """
    width = 1.3 * wavelength_nm / 550
    share = ideal_mm / 1.2
    out, along = 3.0 * share, 2.0 * share

    def gaussian(x, y):
        return np.exp(-0.5 * (x**2 + y**2) / width**2)

    return 0.75 * gaussian(xi_um, eta_um) + 0.25 * gaussian(xi_um - out, eta_um - along)


def psf_export(
    ideal_mm,
    wavelength_nm,
    *,
    kind="Huygens",
    field="angle",
    side=1,
    spacing_um=0.5,
    size=64,
    centre=(33, 33),
    centre_mm=None,
    first_row="+y",
):
    """Return the text of a PSF export: fields on the y axis, rows from +y to -y unless told so.

    ``centre`` counts from 1; ``centre_mm`` is where it lies, on the chief ray unless given.
    """
    rows, cols = np.indices((size, size))
    chief_mm = real_mm(ideal_mm, wavelength_nm)
    if centre_mm is None:
        centre_mm = chief_mm
    x = (cols - (centre[1] - 1)) * spacing_um
    up = 1 if first_row == "+y" else -1
    y = up * ((centre[0] - 1) - rows) * spacing_um + side * 1e3 * (centre_mm - chief_mm)
    # Above the axis (side 1) radial is up and tangential to the right: seen with y down, x turns
    # towards y. Below, both are the other way.
    values = light(side * y, side * x, ideal_mm, wavelength_nm)
    angle = side * np.degrees(np.arctan(ideal_mm / EFL_MM))
    where = (
        f"0.0000, {angle:.4f} (deg)." if field == "angle" else f"0.0000, {side * ideal_mm:.4f} mm."
    )
    wave = f"{wavelength_nm / 1e3:.4f}"
    lines = [f"Listing of {kind} PSF Data", "", "File : made-up.zmx", "Title: Gaussians", "", ""]
    if kind == "Huygens":
        lines += ["HUYGENS PSF", f"{wave} µm at {where}"]
        point = f"Center point is: {centre[0]}, {centre[1]}"
        place = f"Center coordinates: 0.00000000E+000, {side * centre_mm:.8E}"
    else:
        lines += ["Polychromatic FFT PSF", f"{wave} to {wave} µm at {where}"]
        point = f"Center point is: row {centre[0]}, column {centre[1]}"
        place = f"Reference Coordinates: 0.00000000E+000, {side * centre_mm:.8E}"
    lines += [
        f"Data spacing is {spacing_um:.3f} µm.",
        f"Data area is {size * spacing_um:.2f} by {size * spacing_um:.2f} µm.",
        "Pupil grid size: 64 by 64",
        f"Image grid size: {size} by {size}",
        point,
        place,
        "Values are relative intensity.",
        "",
    ]
    lines += ["\t".join(f"{value:.6E}" for value in row) for row in values]
    return "\r\n".join(lines) + "\r\n"


def distortion_export(wavelength_nm, half=8, reach_mm=0.95):
    """Return the text of a grid-distortion export: a square grid whose corners lie beyond."""
    lines = [
        "Listing of Grid Distortion Data",
        "",
        "Units are Millimeters.",
        "Field units are degrees",
        f"Wavelength: {wavelength_nm / 1e3:.5f} µm",
        "Reference Coordinates: Xref = 0.00000E+000, Yref = 0.00000E+000",
        "",
        "  i  j  X-Field  Y-Field  R-Field  Predicted X  Predicted Y  Real X  Real Y  Distortion",
    ]
    for i in range(-half, half + 1):
        for j in range(-half, half + 1):
            x, y = i / half * reach_mm, j / half * reach_mm
            r = np.hypot(x, y)
            grown = real_mm(r, wavelength_nm) / r if r else 1.0
            angles = [np.degrees(np.arctan(v / EFL_MM)) for v in (x, y, r)]
            numbers = [*angles, x, y, x * grown, y * grown]
            text = " ".join(f"{number:.5E}" for number in numbers)
            lines.append(f"{i:4d} {j:4d} {text} {100 * (grown - 1):.6f}%")
    lines += ["", "Maximum distortion: -1.0000%", "Predicted coordinate ABCD matrix:", "A = 5.0"]
    return "\r\n".join(lines) + "\r\n"


ZEMAX_YAML = """
title: Gaussians
source: made up
efl_mm: 5.0
f_number: 2.8
working_f_number: 2.9
transmission: [0.90, 0.92, 0.91]
reference_nm: 550
field_type: angle
relative_illumination: [1.0, 0.98, 0.93, 0.85]
"""


def write_zemax(folder: Path, encoding="utf-16", grids=True, **options):
    """Write exports of all fields and wavelengths with their YAML file; return that."""
    names, grid_names = [], []
    for w, wavelength in enumerate(WAVELENGTHS_NM):
        for f, ideal in enumerate(IDEAL_MM):
            names.append(f"f{f}_w{w}.txt")
            text = psf_export(ideal, wavelength, **options)
            (folder / names[-1]).write_bytes(text.encode(encoding))
        if grids:
            grid_names.append(f"grid_{w}.txt")
            (folder / grid_names[-1]).write_bytes(distortion_export(wavelength).encode(encoding))
    file = folder / "lens.yaml"
    text = f"{ZEMAX_YAML}psf_files: [{', '.join(names)}]\n"
    if "first_row" in options:
        text += f'first_row: "{options["first_row"]}"\n'
    file.write_text(text + (f"distortion_files: [{', '.join(grid_names)}]\n" if grids else ""))
    return file


ISETPARMS = """%   C:\\LENSES\\made-up.zmx
lensFile='made-up.zmx';     %Lens file name
psfSize=64;                 % PSF ROW AND COL SIZE
psfSpacing=0.0005000;   % PSF GRID SPACING IN MM
wave=450:100:650;            % WAVELENGTH SAMPLES (NM)
imgHeightNum=4;                % Number of IMAGE HEIGHTS
imgHeightMax=1.2000000;                % Maximum IMAGE HEIGHT (mm)
objDist=10000000000.000;                 % OBJECT DISTANCE (MM)
mag=0.000000;          % OPTICAL SYSTEM MAGNIFICATION
baseLensFileName='C:\\LENSES\\made-up\\made-up'
refWave=549.000;          % REFERENCE WAVELENGTH (NM)
fov=13.495733;          % MAXIMUM DIAGONAL HALF FOV (DEGREE)
efl=5.000000;          % EFFECTIVE FOCAL LENGTH
fnumber_eff=2.900000;          % EFFECTIVE F-NUMBER
fnumber=2.800000;          % F-NUMBER
"""


def write_isetcam(folder: Path, pattern="made-up_2D_PSF_Fld{}_Wave{}.dat"):
    """Write a folder as ISETCam's macro does: PSFs at negative heights; return its ISETPARMS."""
    (folder / "ISETPARMS.TXT").write_bytes(ISETPARMS.encode("cp1252"))
    (folder / "ISETPARMS.yaml").write_text("transmission: 0.9\n")
    for w, wavelength in enumerate(WAVELENGTHS_NM, start=1):
        for f, ideal in enumerate(IDEAL_MM, start=1):
            text = psf_export(ideal, wavelength, side=-1, field="height")
            (folder / pattern.format(f, w)).write_bytes(text.encode("cp1252"))
    for name, table in (
        ("DI", [[real_mm(h, w) for w in WAVELENGTHS_NM] for h in IDEAL_MM]),
        ("RI", [[value] * 3 for value in ILLUMINATION]),
    ):
        lines = "\n".join(" ".join(f"{value:.6E}" for value in row) for row in table)
        (folder / f"made-up_{name}_.dat").write_text(lines + "\n")
    return folder / "ISETPARMS.TXT"


def expected_psf(ideal_mm, wavelength_nm, size, pitch_um):
    """Return what the bank must hold: sum 1, in the circle."""
    at = (np.arange(size) - size // 2) * pitch_um
    psf = light(at[None, :], at[:, None], ideal_mm, wavelength_nm)
    psf = psf * (np.hypot(at, at[:, None]) < size // 2 * pitch_um)
    return psf / psf.sum()
