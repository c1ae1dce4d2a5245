"""What the readers of other programs' lens files share: fields, vignetting and the last steps.

A prescription states its field as an angle and its vignetting as clear apertures. Files of design
programs may state image heights and vignetting factors in their place; they are converted here,
and the import log says so.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

import numpy as np
from scipy.optimize import brentq

from gpusim.errors import UserError
from gpusim.formats.agf import with_file_catalogues
from gpusim.lens.aim import aim, launch_field
from gpusim.lens.import_log import ImportLog
from gpusim.lens.prescription import Prescription, validated
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build, conjugates, first_order, geometry_of
from gpusim.lens.trace import trace

# Design programs write an object at infinity as a distance of 1e10 lens units or more. From there
# the wavefront over a pupil of 50 mm sags by 6e-5 waves.
INFINITE = 1e10
# What becomes of a glass of which nd and Vd alone are known.
ON_LINE = "by a model glass with the partial dispersions that most glasses have"
# What a lens whose file states the axis alone is used to. The tangential image of a thin lens of
# index n at its own stop is curved by (3 + 1/n) h^2 / (2 f) (Welford, Aberrations of Optical
# Systems, sec. 12.4): with f = 50 mm at f/4 it is blurred by 28 um here, by 180 um at 5 deg.
SMALL_FIELD_DEG = 2.0
_LEAST_FIELD_DEG = 0.05
# Steps of the searches for a field. Chief-ray maps are monotone. A step need only stay below the
# field at which a lens that passes more than that has lost the chief ray.
_STEP_DEG = 4.0
_LAST_DEG = 116.0  # a whole number of steps below the model's limit of 120 deg

FieldKind = Literal[
    "angle", "object height", "paraxial image height", "real image height", "not stated"
]


@dataclass(frozen=True)
class Beam:
    """The part of the stop that a field's beam fills by its vignetting factors: an ellipse.

    ``angle_deg`` is the field; centre and half axes are in stop radii.
    """

    angle_deg: float
    centre_x: float
    centre_y: float
    half_x: float
    half_y: float

    @classmethod
    def of_field(
        cls,
        y_deg: float,
        centre_x: float = 0.0,
        centre_y: float = 0.0,
        half_x: float = 1.0,
        half_y: float = 1.0,
    ) -> Self:
        """Return the beam of a field along y; of one below the axis, in the mirror."""
        return cls(abs(y_deg), centre_x, -centre_y if y_deg < 0 else centre_y, half_x, half_y)


@dataclass(frozen=True)
class Fields:
    """The fields of a file.

    ``sizes`` are radial: angles in deg, or heights in the file's own unit; empty where the
    file states no field, and then the lens is used as far as its clear apertures let it.
    """

    kind: FieldKind
    sizes: tuple[float, ...] = ()
    beams: tuple[Beam, ...] = ()

    @classmethod
    def at(
        cls,
        kind: FieldKind,
        places: Iterable[tuple[float, float]],
        beams: tuple[Beam, ...] = (),
    ) -> Self:
        """Return fields at x and y: projected angles in deg, or heights."""
        size = radial_angle_deg if kind == "angle" else math.hypot
        return cls(kind, tuple(size(x, y) for x, y in places), beams)


def radial_angle_deg(x_deg: float, y_deg: float) -> float:
    """Return the angle from the axis of a direction whose projections make two angles."""
    if x_deg == 0 or y_deg == 0:
        return abs(x_deg + y_deg)
    slopes = math.tan(math.radians(x_deg)), math.tan(math.radians(y_deg))
    return math.degrees(math.atan(math.hypot(*slopes)))


def finished(
    data: dict[str, object],
    fields: Fields,
    import_log: ImportLog,
    file: Path,
    program: str,
    *,
    unit_mm: float = 1.0,
    working_f_number: bool = False,
) -> Prescription:
    """Return the prescription that a reader has found, its fields as angles and lengths in mm.

    Parameters
    ----------
    data : dict
        Everything but ``max_field_deg``, in the unit of the file.
    fields : Fields
    import_log : ImportLog
    file : Path
    program : str
        Whose file it is, for the history.
    unit_mm : float
        The file's unit of length in mm.
    working_f_number : bool
        Whether its f-number is 1 / (2 tan u') of the beam from its object, and not that of an
        object at infinity.

    Raises
    ------
    UserError
        Where the prescription is not complete, or a field cannot be converted.
    """
    angle = max(fields.sizes) if fields.kind == "angle" else 0.0
    lens = validated(data | {"max_field_deg": angle}, file)
    lens._import_log = import_log
    steps = [f"substituted {text}" for text in import_log.listed("substituted")]
    lens = with_file_catalogues(lens.derived("; ".join([f"read from a {program} file", *steps])))
    if unit_mm != 1:
        lens = lens.resized(unit_mm)
    if lens.object_distance_mm is not None and lens.f_number is not None:
        lens = _with_pupil(lens, working_f_number)
    if fields.kind != "angle":
        lens = _with_angle(lens, fields, unit_mm)
    if any(beam.half_x < 1 or beam.half_y < 1 for beam in fields.beams):
        lens = _with_beams(lens, fields.beams)
    return lens


def _with_pupil(lens: Prescription, working: bool) -> Prescription:
    """Return a lens before a near object with its f-number by the entrance pupil's diameter.

    Design programs aim at the rim of that from the object; cameras mark another.
    """
    order = first_order(lens)
    diameter = order.entrance_pupil_diameter_mm
    if working:  # as wide as it takes: paraxial angles go with the diameter
        diameter *= conjugates(lens).working_f_number / lens.f_number
    kind = "working f-number" if working else "f-number at infinity"
    step = f"{kind} {lens.f_number:g} by an entrance pupil {diameter:.6g} mm wide"
    lens.import_log.substituted("file", step)
    return lens.derived(
        f"substituted {step}", f_number=None, entrance_pupil_diameter_mm=float(diameter)
    )


def _with_angle(lens: Prescription, fields: Fields, unit_mm: float) -> Prescription:
    """Return the lens with its field converted to an angle at the reference wavelength."""
    if fields.kind == "not stated":
        angle = _widest(lens)
        step = f"field not stated: by {angle:g} deg, as far as the chief ray passes the apertures"
    else:
        height = max(fields.sizes) * unit_mm
        angle = _angle_of(lens, height, fields.kind)
        step = f"{fields.kind} {height:g} mm by the field angle {angle:.6g} deg"
    lens.import_log.substituted("file", step)
    return lens.derived(f"substituted {step}", max_field_deg=angle)


def with_small_field(lens: Prescription) -> Prescription:
    """Return a lens whose file states the axis alone, used to ``SMALL_FIELD_DEG`` off it.

    Or to a half of that, a quarter and so on: the largest at which the chief ray passes. Cameras
    take it as far as their sensor goes instead (``with_field_to``).

    Raises
    ------
    UserError
        Where the lens forms no image, or no chief ray off its axis passes.
    """
    build(lens)  # what is wrong on the axis already is said as it is
    angle = SMALL_FIELD_DEG
    while not _passes(lens, angle):
        angle /= 2
        if angle < _LEAST_FIELD_DEG:
            raise UserError(
                "the file states the axis alone, and no chief ray off it passes the lens",
                file=lens.file,
                field="max_field_deg",
                value=0,
                allowed=f"clear apertures that pass {_LEAST_FIELD_DEG:g} deg, or a field in the "
                "file",
            )
    step = f"field on the axis alone: by {angle:g} deg, a small field; a camera takes its sensor's"
    lens.import_log.substituted("file", step)
    opened = lens.derived(f"substituted {step}", max_field_deg=angle)
    opened._states_axis_alone = True
    return opened


def with_field_to(lens: Prescription, height_mm: float) -> Prescription:
    """Return a lens whose file states the axis alone, used to an image height.

    Raises
    ------
    UserError
        Where no chief ray lands there, or a clear aperture stops it.
    """
    refused = UserError(
        "the lens, whose file states the axis alone, does not reach the corners of the sensor",
        file=lens.file,
        field="sensor",
        value=f"corner at {height_mm:.4g} mm",
        allowed="fewer pixels, a longer focal length, or a lens with a wider field",
    )
    try:
        angle = _angle_of(lens, height_mm, "real image height")
    except UserError as error:
        raise refused from error
    if not _passes(lens, angle):
        raise refused
    step = f"field of {angle:.4g} deg, to the corners of the sensor"
    lens.import_log.substituted("file", step)
    return lens.derived(step, max_field_deg=angle)


def _passes(lens: Prescription, angle_deg: float) -> bool:
    """Whether the chief ray of a lens that is used so far passes its clear apertures."""
    try:
        return _chief(build(lens.model_copy(update={"max_field_deg": angle_deg})), angle_deg)[1]
    except UserError:
        return False


def _angle_of(lens: Prescription, height_mm: float, kind: str) -> float:
    if kind == "object height":
        geometry = geometry_of(lens)
        return math.degrees(math.atan(height_mm / (geometry.field_z - geometry.object_z)))
    if kind == "paraxial image height":  # h = c tan(theta), by definition
        return math.degrees(math.atan(height_mm / conjugates(lens).principal_distance_mm))
    system = build(lens)

    def excess(angle: float) -> float:
        return abs(_chief(system, angle)[0]) - height_mm

    angle = 0.0
    while excess(angle) < 0:
        angle += _STEP_DEG
        if angle > _LAST_DEG:
            raise UserError(
                "no field angle to 116 deg gives the image height",
                file=lens.file,
                field="fields",
                value=f"{height_mm:g} mm",
                allowed="a smaller image height",
            )
    if angle == 0:
        return 0.0
    return float(brentq(excess, angle - _STEP_DEG, angle, xtol=1e-10))


def _widest(lens: Prescription) -> float:
    """Return the largest field whose chief ray passes all clear apertures, to 0.01 deg below."""
    system = build(lens)

    def passes(angle: float) -> bool:
        try:
            return _chief(system, angle)[1]
        except UserError:  # it misses a surface
            return False

    high = _STEP_DEG
    while high < _LAST_DEG and passes(high):
        high += _STEP_DEG
    low = high - _STEP_DEG
    while high - low > 0.001:
        middle = (low + high) / 2
        low, high = (middle, high) if passes(middle) else (low, middle)
    return math.floor(low * 100) / 100


def _chief(system, angle_deg: float) -> tuple[float, bool]:
    """Image height of the chief ray at the reference wavelength, and whether nothing clips it."""
    index = system.index(np.array([system.prescription.reference_nm]))
    rays = sample_rays(system, index, math.radians(angle_deg), np.zeros(1), np.zeros(1))
    return float(rays.chief_y_mm[0]), bool(rays.inside.all())


def _with_beams(lens: Prescription, beams: Iterable[Beam]) -> Prescription:
    """Return the lens with missing clear apertures that just pass the vignetted beams.

    Design programs size the surfaces that way where the designer did not; such apertures vignette
    as the factors do, to the extent that ellipses can say it.

    Raises
    ------
    UserError
        Where a ray of the beams does not pass the surfaces.
    """
    missing = [
        i
        for i, surface in enumerate(lens.surfaces)
        if surface.semi_diameter is None and (surface.glass or (i and lens.surfaces[i - 1].glass))
    ]
    if not missing:
        return lens
    system = build(lens.model_copy(update={"max_field_deg": 0.0}))
    index = system.index(np.array([lens.reference_nm]))
    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    radius = system.stop_radius_mm
    needed = np.zeros(len(lens.surfaces))
    for beam in beams:
        x = radius * (beam.centre_x + beam.half_x * np.cos(turn))
        y = radius * (beam.centre_y + beam.half_y * np.sin(turn))
        theta = math.radians(beam.angle_deg)
        launch, reached = launch_field(system.geometry, index, theta, 1e-9 * radius)
        px, py, found = aim(system.geometry, index, launch, x, y, tolerance_mm=1e-9 * radius)
        rays = trace(system.geometry, index, launch, px, py)
        if not (reached.all() and (found & rays.ok).all()):
            raise UserError(
                "the vignetting factors describe a beam that does not pass the lens",
                file=lens.file,
                field="vignetting factors",
                value=f"at {beam.angle_deg:g} deg",
                allowed="clear apertures, or larger vignetting factors",
            )
        needed = np.maximum(needed, np.hypot(rays.x, rays.y).max(axis=(1, 2)))
    surfaces = list(lens.surfaces)
    for i in missing:
        surfaces[i] = surfaces[i].model_copy(update={"semi_diameter": float(needed[i])})
    names = ", ".join(str(i + 1) for i in missing)
    return lens.derived(
        f"clear apertures of surfaces {names} computed: they pass the beams of the vignetting "
        "factors",
        surfaces=tuple(surfaces),
    )
