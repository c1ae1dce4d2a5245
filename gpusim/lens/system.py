"""A lens ready to be traced: indices, real stop radius, clear apertures, focus; first order."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np

from gpusim.errors import UserError
from gpusim.lens import glass
from gpusim.lens.aim import aim, launch_field
from gpusim.lens.geometry import Geometry
from gpusim.lens.launch import Launch
from gpusim.lens.model import LensModel
from gpusim.lens.projection import RECTILINEAR
from gpusim.lens.throughput import along_axis
from gpusim.lens.trace import entrance_pupil, paraxial, trace
from gpusim.lens.wavefront import best_focus_shift


@dataclass(frozen=True)
class FirstOrder:
    """Paraxial properties at one wavelength, of the surfaces on their axis; lengths in mm.

    ``bfl_mm`` is the distance from the last vertex to the paraxial focus; pupil positions are
    measured from the first vertex (entrance) and from the last (exit).
    """

    wavelength_nm: float
    efl_mm: float
    bfl_mm: float
    f_number: float
    entrance_pupil_diameter_mm: float
    entrance_pupil_z_mm: float
    exit_pupil_diameter_mm: float
    exit_pupil_z_mm: float
    length_mm: float


@dataclass(frozen=True)
class Conjugates:
    """Paraxial imaging of the object plane that a lens looks at, at one wavelength; lengths in mm.

    ``image_mm`` is from the last vertex to the image of the distance that the lens is focused on;
    ``magnification`` that of the object in this plane, less than 0 for an inverted image, 0 of an
    object at infinity. The principal distance is the ideal height of a chief ray over the tangent
    of its field angle: the focal length of a lens focused on infinity. ``working_f_number`` is
    1 / (2 tan u') of the axial beam.
    """

    image_mm: float
    magnification: float
    principal_distance_mm: float
    working_f_number: float


@dataclass(frozen=True)
class System:
    """A prescription with everything that follows from it.

    Attributes
    ----------
    prescription : LensModel
    geometry : Geometry
    stop_radius_mm : float
        Real radius of the diaphragm.
    semi_diameter_mm : ndarray, shape (S,)
        Clear apertures; infinite where the surface has none.
    image_z_mm : float
        Place of the image plane.
    """

    prescription: LensModel
    geometry: Geometry
    stop_radius_mm: float
    semi_diameter_mm: np.ndarray
    image_z_mm: float

    def index(self, wavelengths_nm: np.ndarray) -> np.ndarray:
        """Return the refractive indices, shape (S + 1, L): before the lens, behind each surface."""
        return indices(self.prescription, wavelengths_nm)


def geometry_of(prescription: LensModel) -> Geometry:
    """Return the shapes of a prescription, and where its object is, as arrays."""
    surfaces = prescription.surfaces
    gaps = [s.thickness for s in surfaces[:-1]]
    geometry = Geometry(
        curvature=np.array([s.vertex_curvature for s in surfaces]),
        conic=np.array([s.conic for s in surfaces]),
        asphere=np.array([s.asphere.coefficients for s in surfaces]),
        vertex_z=np.concatenate([[0.0], np.cumsum(gaps)]),
        stop=prescription.stop - 1,
        decentre=np.array([s.decentre_mm for s in surfaces]),
        rotation=np.array([s.rotation for s in surfaces]),
    )
    if prescription.object_distance_mm is None:
        return geometry
    index = indices(prescription, np.array([prescription.reference_nm]))
    return replace(
        geometry,
        object_z=-prescription.object_distance_mm,
        field_z=float(entrance_pupil(geometry, index)[0][0]),
    )


def indices(
    prescription: LensModel, wavelengths_nm: np.ndarray, *, printed: bool = False
) -> np.ndarray:
    """Return the refractive indices, shape (S + 1, L); ``printed`` takes the source's nd and vd."""
    wavelengths_nm = np.atleast_1d(np.asarray(wavelengths_nm, dtype=float))
    behind = [
        glass.surface_index(
            surface,
            number,
            prescription.glass_catalogues,
            wavelengths_nm,
            file=prescription.file,
            printed=printed,
        )
        for number, surface in enumerate(prescription.surfaces, start=1)
    ]
    return np.array([np.ones(len(wavelengths_nm)), *behind])


def first_order(
    prescription: LensModel, wavelength_nm: float | None = None, *, printed: bool = False
) -> FirstOrder:
    """Return the paraxial properties of a lens.

    Parameters
    ----------
    prescription : LensModel
    wavelength_nm : float, optional
        Wavelength (the prescription's reference wavelength).
    printed : bool
        Use the source's printed indices in place of catalogue glasses.

    Raises
    ------
    UserError
        Where a glass is unknown, or the lens has no focal length greater than 0.
    """
    wavelength = prescription.reference_nm if wavelength_nm is None else float(wavelength_nm)
    geometry = geometry_of(prescription)
    index = indices(prescription, np.array([wavelength]), printed=printed)
    heights, angles = paraxial(geometry, index, 1.0, 0.0)
    height, angle = float(heights[-1, 0]), float(angles[-1, 0])
    if not angle < 0:
        raise UserError(
            "the lens forms no real image of an object at infinity",
            file=prescription.file,
            field="surfaces",
            allowed="a focal length greater than 0",
        )
    efl = -1.0 / angle
    pupil_z, magnification = (float(a[0]) for a in entrance_pupil(geometry, index))
    # The paraxial chief ray, which enters through the centre of one pupil at unit angle, leaves
    # through that of the other.
    chief_y, chief_u = paraxial(geometry, index, -pupil_z, 1.0)
    y, u = float(chief_y[-1, 0]), float(chief_u[-1, 0])
    if prescription.f_number is not None:
        diameter = efl / prescription.f_number
    elif prescription.entrance_pupil_diameter_mm is not None:
        diameter = prescription.entrance_pupil_diameter_mm
    elif prescription.object_na is not None:
        slope = np.tan(np.arcsin(prescription.object_na))
        diameter = 2 * float(slope) * (prescription.object_distance_mm + pupil_z)
    else:
        diameter = 2 * prescription.stop_semi_diameter_mm / abs(magnification)
    # Lagrange invariant between the pupils: both are in air, so D' u' = D u. A telecentric lens
    # (u' = 0) has its exit pupil at infinity.
    return FirstOrder(
        wavelength_nm=wavelength,
        efl_mm=efl,
        bfl_mm=efl * height,
        f_number=efl / diameter,
        entrance_pupil_diameter_mm=diameter,
        entrance_pupil_z_mm=pupil_z,
        exit_pupil_diameter_mm=diameter / abs(u) if u else np.inf,
        exit_pupil_z_mm=-y / u if u else np.inf,
        length_mm=float(geometry.vertex_z[-1]),
    )


def conjugates(prescription: LensModel, wavelength_nm: float | None = None) -> Conjugates:
    """Return how a lens images the plane that it looks at, from paraxial rays.

    Parameters
    ----------
    prescription : LensModel
    wavelength_nm : float, optional
        Wavelength (the prescription's reference wavelength).

    Raises
    ------
    UserError
        Where a glass is unknown, or the lens forms no real image of what it is focused on.
    """
    wavelength = prescription.reference_nm if wavelength_nm is None else float(wavelength_nm)
    order = first_order(prescription, wavelength)
    geometry = geometry_of(prescription)
    index = indices(prescription, np.array([wavelength]))
    focused, distance = prescription.focused_mm, prescription.object_distance_mm
    image = order.bfl_mm if focused is None else _image_mm(prescription, geometry, index, focused)
    radius = order.entrance_pupil_diameter_mm / 2
    if distance is None:
        u = paraxial(geometry, index, radius, 0.0)[1, -1, 0]
        if focused is None:
            scale = order.efl_mm
        else:  # the chief ray of unit slope, in that plane
            scale = _reaches(geometry, index, -order.entrance_pupil_z_mm, 1.0, image)
        return Conjugates(image, 0.0, scale, float(-0.5 / u))
    far = distance + order.entrance_pupil_z_mm
    # From an object of height 1 to the pupil's middle; then from the axis to the pupil's rim.
    magnification = _reaches(geometry, index, 1 - distance / far, -1 / far, image)
    u = paraxial(geometry, index, radius * distance / far, radius / far)[1, -1, 0]
    return Conjugates(
        image_mm=image,
        magnification=magnification,
        principal_distance_mm=magnification * (geometry.object_z - geometry.field_z),
        working_f_number=float(-0.5 / u),
    )


def _reaches(geometry: Geometry, index: np.ndarray, y: float, u: float, image_mm: float) -> float:
    """Return the height at which a paraxial ray meets a plane behind the last vertex."""
    heights, angles = paraxial(geometry, index, y, u)
    return float(heights[-1, 0] + image_mm * angles[-1, 0])


def _image_mm(
    prescription: LensModel, geometry: Geometry, index: np.ndarray, distance_mm: float
) -> float:
    """Return the distance from the last vertex to the paraxial image of a point of the axis."""
    heights, angles = paraxial(geometry, index, distance_mm, 1.0)
    y, u = float(heights[-1, 0]), float(angles[-1, 0])
    if u < 0 < y:
        return -y / u
    # A ray from the front focus leaves along the axis.
    rays = [paraxial(geometry, index, *start)[1, -1, 0] for start in ((1.0, 0.0), (0.0, 1.0))]
    raise UserError(
        "the lens forms no real image of an object so near",
        file=prescription.file,
        field="object_distance_m" if prescription.focus_distance_mm is None else "focus_distance_m",
        value=f"{1e-3 * distance_mm:g}",
        allowed=f"above {-1e-3 * rays[1] / rays[0]:.4g} m from the first surface, where the lens's "
        "front focus is",
    )


def transmission(prescription: LensModel, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return the share of the light on the axis that passes, shape (L,): `gpusim.lens.throughput`.

    Normal incidence: R = ((n2 - n1) / (n2 + n1))^2 (Born & Wolf, sec. 1.5), or the coating's.

    Raises
    ------
    UserError
        Where a glass or the coating has no data at a wavelength.
    """
    wavelengths = np.atleast_1d(np.asarray(wavelengths_nm, dtype=float))
    return along_axis(prescription, indices(prescription, wavelengths), wavelengths)


@functools.lru_cache(maxsize=64)
def _stop_radius(prescription: LensModel) -> float:
    """Real radius of the stop: where the marginal ray of the axial beam crosses it.

    An f-number is a lens's marking: it is that of an object at infinity, wherever the object is.
    """
    if prescription.stop_semi_diameter_mm is not None:
        return prescription.stop_semi_diameter_mm
    geometry = geometry_of(prescription).centred()
    order = first_order(prescription)
    half = np.array([[order.entrance_pupil_diameter_mm / 2]])
    index = indices(prescription, prescription.reference_nm)
    axis = Launch(0.0, np.zeros((3, 1)))
    if prescription.f_number is None and np.isfinite(geometry.object_z):
        # To the rim of the paraxial entrance pupil.
        axis = replace(axis, source=geometry.source(0.0))
        half *= geometry.object_z / (geometry.object_z - geometry.field_z)
    rays = trace(geometry, index, axis, np.zeros((1, 1)), half, through=geometry.stop + 1)
    if not rays.ok.all():
        raise UserError(
            "the marginal ray of the axial beam does not reach the stop",
            file=prescription.file,
            field="f_number",
            value=f"{order.f_number:.4g}",
            allowed="an aperture that the surfaces can pass",
        )
    return abs(float(rays.y[-1, 0, 0]))


def with_clear_apertures(prescription: LensModel) -> LensModel:
    """Return the lens with every missing semi-diameter set to what the full field needs.

    A surface whose source gives none must pass the whole beam at every field: its semi-diameter
    is the largest height of 64 rim rays and the chief ray at 9 fields from the axis to the largest,
    at the design wavelengths, with every surface on the axis.

    Raises
    ------
    UserError
        Where such a ray does not pass the surfaces, so that the size cannot be computed.
    """
    stop = prescription.stop - 1
    # A diaphragm in air is its own aperture.
    missing = [
        i
        for i, s in enumerate(prescription.surfaces)
        if s.semi_diameter is None and not (i == stop and _is_dummy(prescription, i))
    ]
    if not missing:
        return prescription
    geometry, radius = geometry_of(prescription).centred(), _stop_radius(prescription)
    index = indices(prescription, np.array(prescription.design_wavelengths_nm))
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    needed = np.zeros(len(prescription.surfaces))
    for field in np.radians(np.linspace(0, prescription.max_field_deg, 9)):
        x, y = np.append(radius * np.cos(angle), 0.0), np.append(radius * np.sin(angle), 0.0)
        launch, reached = launch_field(geometry, index, field, 1e-9 * radius)
        px, py, found = aim(geometry, index, launch, x, y, tolerance_mm=1e-9 * radius)
        rays = trace(geometry, index, launch, px, py)
        if not (reached.all() and (found & rays.ok).all()):
            raise UserError(
                "clear apertures cannot be computed: the full beam does not pass the lens at "
                f"{np.degrees(field):.4g} deg",
                file=prescription.file,
                field=f"surfaces.{missing[0] + 1}.semi_diameter",
                allowed="give every semi_diameter, or a smaller max_field_deg",
            )
        needed = np.maximum(needed, np.hypot(rays.x, rays.y).max(axis=(1, 2)))
    surfaces = list(prescription.surfaces)
    for i in missing:
        surfaces[i] = surfaces[i].model_copy(update={"semi_diameter": float(needed[i])})
    names = ", ".join(str(i + 1) for i in missing)
    which = f"apertures of surfaces {names}" if len(missing) > 1 else f"aperture of surface {names}"
    return prescription.derived(
        f"clear {which} computed, for the source gives none: as wide as the full beam to "
        f"{prescription.max_field_deg:g} deg",
        surfaces=tuple(surfaces),
    )


def _is_dummy(prescription: LensModel, i: int) -> bool:
    """Whether surface ``i`` has air on both sides."""
    before = prescription.surfaces[i - 1].glass if i else None
    return before is None and prescription.surfaces[i].glass is None


def build(prescription: LensModel) -> System:
    """Return the lens ready to be traced.

    The stop's radius and the focus are those of the lens with every surface on the axis.

    Raises
    ------
    UserError
        Where a glass is unknown, no ray reaches the stop, there is no real image or a field does
        not meet the object plane.
    """
    finite = prescription.object_distance_mm is not None
    if finite and prescription.max_field_deg > RECTILINEAR.end_deg:
        raise UserError(
            "the object is a plane across the axis, which such fields do not meet",
            file=prescription.file,
            field="max_field_deg",
            value=f"{prescription.max_field_deg:g}",
            allowed=f"up to {RECTILINEAR.end_deg:g}, or an object at infinity",
        )
    prescription = with_clear_apertures(prescription)
    geometry = geometry_of(prescription)
    last = prescription.surfaces[-1].thickness
    distance = last if prescription.focus == "as-given" else conjugates(prescription).image_mm
    clear = [np.inf if s.semi_diameter is None else s.semi_diameter for s in prescription.surfaces]
    system = System(
        prescription=prescription,
        geometry=geometry,
        stop_radius_mm=_stop_radius(prescription),
        semi_diameter_mm=np.array(clear),
        image_z_mm=float(geometry.vertex_z[-1] + distance),
    )
    shift = 1e-3 * prescription.focus_shift_um
    if prescription.focus == "best":
        focused = prescription.focused_mm
        aligned = geometry_of(prescription.model_copy(update={"object_distance_mm": focused}))
        aligned = replace(system, geometry=aligned.centred())
        shift += best_focus_shift(aligned, np.array(prescription.design_wavelengths_nm))
    return replace(system, image_z_mm=system.image_z_mm + shift)
