"""A lens as published, and those made from it: scaled, stopped down, refocused, misaligned."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from gpusim.config.mistakes import checked
from gpusim.errors import UserError
from gpusim.lens.model import APERTURES, LensModel
from gpusim.lens.model_glass import with_nearest
from gpusim.lens.surface import tilt_matrix
from gpusim.lens.system import conjugates, first_order, with_clear_apertures
from gpusim.lens.throughput import without_data


class Prescription(LensModel):
    """A lens as published: its fields are those of `LensModel`, its methods derive other lenses.

    `gpusim.formats.lens_file.load_prescription` reads one.
    """

    def scaled(self, efl_mm: float) -> Prescription:
        """Return the lens scaled to a focal length at its reference wavelength.

        Raises
        ------
        UserError
            Where ``efl_mm`` is not greater than 0.

        Examples
        --------
        >>> import gpusim as gs
        >>> gs.Lens.load("double-gauss").scaled(12.0).history
        ('every length multiplied by 0.119444868',)
        """
        if not (math.isfinite(efl_mm) and efl_mm > 0):
            raise UserError(
                "a focal length must be greater than 0 mm",
                file=self.file,
                field="efl_mm",
                value=efl_mm,
                allowed="> 0",
            )
        return self.resized(efl_mm / first_order(self).efl_mm)

    def stopped(self, f_number: float) -> Prescription:
        """Return the lens with its stop closed to an f-number; the glass keeps its size.

        An apodising filter keeps its size too: the smaller stop passes its middle.

        Raises
        ------
        UserError
            Where the lens does not open so far.

        Examples
        --------
        >>> import gpusim as gs
        >>> gs.Lens.load("double-gauss").stopped(8.0).f_number
        8.0
        """
        widest = first_order(self).f_number
        # The stop may be asked to be where it is already, to the digits that f-numbers have.
        if not (math.isfinite(f_number) and f_number >= widest * (1 - 1e-3)):
            raise UserError(
                "the lens does not open to this f-number",
                file=self.file,
                field="f_number",
                value=f_number,
                allowed=f">= {widest:.4g}",
            )
        return with_clear_apertures(self).derived(
            f"stop closed to f/{f_number:g}",
            gaussian_apodisation=self.gaussian_apodisation * min(1.0, widest / f_number) ** 2,
            **(dict.fromkeys(APERTURES) | {"f_number": float(f_number)}),
        )

    def looking(
        self, object_distance_m: float | None = None, focus_distance_m: float | None = None
    ) -> Prescription:
        """Return the lens with its object and its focus at other distances from its first vertex.

        The lens, or the image plane, is moved until the focus lies there: the stop keeps its size,
        so that an f-number is that of an object at infinity, as cameras mark it.

        Parameters
        ----------
        object_distance_m : float, optional
            Distance of the object plane; infinity is allowed too. By default it stays as it is.
        focus_distance_m : float, optional
            Distance that the lens is focused on; infinity is allowed too. By default the lens
            focuses on the object, unless it has another distance.

        Raises
        ------
        UserError
            Where a distance is not greater than 0, or the lens forms no real image of what it is
            focused on.

        Examples
        --------
        >>> import gpusim as gs
        >>> near = gs.Lens.load("double-gauss").scaled(50.0).looking(object_distance_m=1.0)
        >>> near.object_distance_mm
        1000.0
        """
        changes, steps = {}, []
        for name, given in (("object", object_distance_m), ("focus", focus_distance_m)):
            if given is None:
                continue
            if not given > 0:
                raise UserError(
                    f"the distance of the {name} is not greater than 0",
                    file=self.file,
                    field=f"{name}_distance_m",
                    value=given,
                    allowed="> 0 m from the first surface, infinity too",
                )
            changes[f"{name}_distance_mm"] = 1e3 * given
            steps.append(f"{'focused' if name == 'focus' else 'object'} at {given:g} m")
        if changes.get("object_distance_mm") == math.inf:
            changes["object_distance_mm"] = None
        aperture = {}
        if self.f_number is None and self.stop_semi_diameter_mm is None:
            aperture = dict.fromkeys(APERTURES) | {"f_number": first_order(self).f_number}
        lens = with_clear_apertures(self).derived(", ".join(steps), **aperture, **changes)
        moved = conjugates(lens).image_mm
        if lens.focus != "as-given":
            return lens
        # The plane keeps its distance from the paraxial focus.
        *others, last = lens.surfaces
        thickness = last.thickness + moved - conjugates(self).image_mm
        surfaces = (*others, last.model_copy(update={"thickness": thickness}))
        return lens.model_copy(update={"surfaces": surfaces})

    def absorbing(self) -> Prescription:
        """Return the lens with glasses that absorb; the import log names those without data."""
        for number, name in without_data(self).items():
            what = f"glass {name}: its internal transmission, of which there are no data, by 1"
            self.import_log.substituted(number, what)
        return self.derived("glasses absorb", internal_transmission=True)

    def with_nearest_glasses(self) -> Prescription:
        """Return the lens with each model glass by the nearest one of the glass catalogues.

        See ``gpusim.lens.model_glass``; a model glass that has none near it stays.
        """
        return with_nearest(self)

    def limited(self, max_field_deg: float) -> Prescription:
        """Return the lens used over a smaller field; the glass keeps its size.

        A lens whose file states the axis alone takes any field that it passes.

        Raises
        ------
        UserError
            Where the field is beyond the published one.

        Examples
        --------
        >>> import gpusim as gs
        >>> gs.Lens.load("double-gauss").limited(10.0).max_field_deg
        10.0
        """
        if self.states_axis_alone and 0 < max_field_deg < 90:
            return self.derived(
                f"field of {max_field_deg:g} deg chosen", max_field_deg=float(max_field_deg)
            )
        if not 0 <= max_field_deg <= self.max_field_deg:
            raise UserError(
                "the field lies beyond the lens",
                file=self.file,
                field="max_field_deg",
                value=max_field_deg,
                allowed=f"0 to {self.max_field_deg:g}",
            )
        return with_clear_apertures(self).derived(
            f"field limited to {max_field_deg:g} deg", max_field_deg=float(max_field_deg)
        )

    def with_element_moved(
        self,
        first: int,
        last: int,
        decentre_mm: tuple[float, float] = (0.0, 0.0),
        tilt_deg: tuple[float, float] = (0.0, 0.0),
    ) -> Prescription:
        """Return the lens with an element decentred and tilted as one rigid body.

        Parameters
        ----------
        first, last : int
            Numbers of its first and last surface, from 1.
        decentre_mm, tilt_deg : tuple of float
            As for a ``Surface``, about the vertex of the first one. The vertices behind it move
            along the axis too: the spaces there take up the difference, so that everything else,
            the image plane with it, stays where it is.

        Raises
        ------
        UserError
            Where there are no such surfaces, or a surface would be turned by 90 deg or more.

        Examples
        --------
        >>> import gpusim as gs
        >>> lens = gs.Lens.load("double-gauss").with_element_moved(1, 2, decentre_mm=(0.0, 0.02))
        >>> lens.is_centred
        False
        """
        count = len(self.surfaces)
        if not 1 <= first <= last <= count:
            raise UserError(
                "no such element",
                file=self.file,
                field="surfaces",
                value=f"{first} to {last}",
                allowed=f"surface numbers from 1 to {count}, the first not after the last",
            )
        lens = with_clear_apertures(self)  # the glass keeps its size
        surfaces, turn = list(lens.surfaces), tilt_matrix(tilt_deg)
        pivot = np.array([*surfaces[first - 1].decentre_mm, 0.0])
        z, moved_by = 0.0, np.zeros(count + 1)  # along the axis; the image plane is last
        for i in range(first - 1, last):
            arm = np.array([*surfaces[i].decentre_mm, z]) - pivot
            place = pivot + turn @ arm + np.array([*decentre_mm, 0.0])
            moved_by[i] = place[2] - z
            # A surface of revolution is turned by where its axis points.
            ax, ay, az = turn @ surfaces[i].rotation[:, 2]
            tilt = (math.degrees(math.atan2(-ay, az)), math.degrees(math.asin(ax)))
            if not max(abs(a) for a in tilt) < 90:
                raise UserError(
                    "the element is turned too far",
                    file=self.file,
                    field=f"surfaces.{i + 1}.tilt_deg",
                    value=f"{tilt[0]:g}, {tilt[1]:g}",
                    allowed="less than 90",
                )
            z += surfaces[i].thickness or 0.0
            surfaces[i] = surfaces[i].model_copy(
                update={"decentre_mm": (float(place[0]), float(place[1])), "tilt_deg": tilt}
            )
        for i in range(count):
            if surfaces[i].thickness is not None:
                longer = float(moved_by[i + 1] - moved_by[i])
                thickness = surfaces[i].thickness + longer
                surfaces[i] = surfaces[i].model_copy(update={"thickness": thickness})
        x, y = decentre_mm
        return lens.derived(
            f"surfaces {first} to {last} decentred by {x:g}, {y:g} mm and tilted by "
            f"{tilt_deg[0]:g}, {tilt_deg[1]:g} deg about the vertex of surface {first}",
            surfaces=tuple(surfaces),
        )


def validated(data: object, file: Path) -> Prescription:
    """Return the prescription in ``data``, or one UserError that names the first wrong field."""
    prescription = checked(Prescription, data, file)
    prescription._file = file
    return prescription
