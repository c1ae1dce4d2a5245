"""What a bank that was read from a file must obey, so that the chain can take it as any other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from gpusim.errors import UserError
from gpusim.psf.bank import Bank
from gpusim.psf.field_map import FieldMap
from gpusim.psf.plane_bank import PlaneBank

MAX_SIZE = 1024  # samples across a PSF: the longest transform of the convolution

# Takes the name of a variable, its value and what is allowed.
Wrong = Callable[[str, object, str], UserError]


def check_bank(bank: Bank, file: Path) -> None:
    """Refuse a bank of a lens with an axis that breaks its contract.

    Raises
    ------
    UserError
        Names the first variable that is wrong.
    """

    def wrong(name: str, value: object, allowed: str) -> UserError:
        return UserError(
            "a variable of the bank is wrong", file=file, field=name, value=value, allowed=allowed
        )

    _check_shapes(bank, wrong)
    _check_chief_rays(bank, wrong)
    _check_light(bank, wrong)


def _check_shapes(bank: Bank, wrong: Wrong) -> None:
    """Refuse arrays that do not go together, or hold no numbers."""
    fields, count = len(np.atleast_1d(bank.field_deg)), len(np.atleast_1d(bank.wavelengths_nm))
    size = np.shape(bank.psf)[-1] if np.ndim(bank.psf) else 0
    table = (fields, count)
    shapes = {
        "wavelengths_nm": (count,),
        "field_deg": (fields,),
        "ideal_height_um": (fields,),
        "real_height_um": table,
        "psf": (*table, size, size),
        "relative_illumination": table,
        "projected_solid_angle_sr": (count,),
        "transmission": (count,),
        "outside_energy": table,
    }
    if bank.cone is not None:
        rays = np.shape(bank.cone)[2] if np.ndim(bank.cone) == 4 else 0
        shapes |= {"chief": (*table, 2), "cone": (*table, rays, 3)}

    if bank.ray_deg is not None:
        rays = len(np.atleast_1d(bank.ray_deg))
        shapes |= {"ray_deg": (rays,), "ray_um": (rays, count)}
    if bank.halo is not None:
        levels, across = np.shape(bank.halo)[0], np.shape(bank.halo)[-1]
        shapes |= {"halo": (levels, *table, across, across), "halo_pitch_um": (levels,)}
        shapes |= {"beyond_energy": table}

    for name, shape in shapes.items():
        array = np.asarray(getattr(bank, name))
        if array.shape != shape:
            raise wrong(name, f"shape {array.shape}", f"shape {shape}")
        is_number = np.issubdtype(array.dtype, np.number) and not np.isnan(array).any()
        # A fisheye's ideal heights have no end.
        if not is_number or (name != "ideal_height_um" and not np.isfinite(array).all()):
            raise wrong(name, "values that are no numbers", "finite numbers")
    if fields < 2 or count < 1 or size % 2 or not 16 <= size <= MAX_SIZE:
        raise wrong(
            "psf",
            f"{fields} fields, {count} wavelengths, {size} samples across",
            f"2 fields or more, 1 wavelength or more, an even number of samples, 16 to {MAX_SIZE}",
        )
    for name in ("efl_mm", "f_number", "pitch_um"):
        if not (np.isfinite(getattr(bank, name)) and getattr(bank, name) > 0):
            raise wrong(name, getattr(bank, name), "above 0")


def _check_chief_rays(bank: Bank, wrong: Wrong) -> None:
    """Refuse fields, heights and wavelengths that are in disorder."""
    rising = ("field_deg", "real_height_um")
    for name in rising if bank.ray_deg is None else (*rising, "ray_deg", "ray_um"):
        array = getattr(bank, name)
        if np.any(array[0] != 0) or not (np.diff(array, axis=0) > 0).all():
            raise wrong(name, "not rising from 0", "0 at the first field, then rising")
    if bank.field_deg[-1] >= 180:
        raise wrong("field_deg", bank.field_deg[-1], "below 180")
    theta, scale_um = np.radians(bank.field_deg), 1e3 * bank.principal_distance_mm
    ideal = np.where(theta < np.pi / 2, scale_um * np.tan(theta), np.inf)
    if not np.allclose(bank.ideal_height_um, ideal, rtol=1e-6, atol=1e-6):
        raise wrong("ideal_height_um", "other heights", "efl_mm times tan(field_deg)")
    folds = [FieldMap(theta, column, scale_um).folds_at for column in bank.real_height_um.T]
    if bank.ray_deg is not None and not np.allclose(
        [bank.ray_deg[-1], *bank.ray_um[-1]], [bank.field_deg[-1], *bank.real_height_um[-1]]
    ):
        raise wrong("ray_deg, ray_um", "another end", "the last field")
    if any(fold is not None for fold in folds):
        angle = np.degrees(min(fold for fold in folds if fold is not None))
        raise wrong("real_height_um", f"falling from {angle:.4g} deg", "rising between fields too")
    if bank.wavelengths_nm[0] <= 0 or not (np.diff(bank.wavelengths_nm) > 0).all():
        raise wrong("wavelengths_nm", str(bank.wavelengths_nm), "above 0 and rising")
    if bank.reference_nm not in bank.wavelengths_nm:
        raise wrong("reference_nm", bank.reference_nm, f"one of {bank.wavelengths_nm}")


def _check_light(bank: Bank, wrong: Wrong) -> None:
    """Refuse shares of the light that are none, or do not add up."""
    ranges = {
        "relative_illumination": (0, 2),
        "projected_solid_angle_sr": (0, np.pi),
        "transmission": (0, 1),
        "outside_energy": (-1, 1),  # a sharpened MTF has more than all of its light in the circle
    }
    for name, (low, high) in ranges.items():
        array = getattr(bank, name)
        if array.min() < low or array.max() > high:
            raise wrong(name, f"{array.min():g} to {array.max():g}", f"{low:g} to {high:.4g}")
    if np.abs(bank.relative_illumination[0] - 1).max() > 1e-3:
        raise wrong("relative_illumination", str(bank.relative_illumination[0]), "1 on the axis")
    sums = bank.psf.sum(axis=(2, 3), dtype=float)
    if bank.halo is None:
        if np.abs(sums - 1).max() > 1e-3:
            raise wrong("psf", f"sums {sums.min():g} to {sums.max():g}", "sum 1 for each PSF")
        return
    if np.abs(sums + bank.outside_energy - 1).max() > 1e-3:
        raise wrong(
            "psf", f"sums {sums.min():g} to {sums.max():g}", "1 less outside_energy for each PSF"
        )
    held = sum(level.psf.sum(axis=(2, 3), dtype=float) for level in bank.levels)
    if np.abs(held + bank.beyond_energy - 1).max() > 1e-3:
        raise wrong(
            "halo",
            f"with the PSFs' cores {held.min():g} to {held.max():g}",
            "1 less beyond_energy for each PSF",
        )


def check_plane_bank(bank: PlaneBank, file: Path) -> None:
    """Refuse a bank of a lens without an axis that breaks its contract.

    Raises
    ------
    UserError
        Names the first variable that is wrong.
    """
    for name in bank.table.variables:
        if not np.isfinite(getattr(bank, name)).all():
            raise UserError(
                "the bank holds values that are no numbers",
                file=file,
                field=name,
                allowed="finite numbers",
            )
    rising = (bank.wavelengths_nm, bank.field_x_deg, bank.field_y_deg)
    if bank.reference_nm not in bank.wavelengths_nm or any((np.diff(a) <= 0).any() for a in rising):
        raise UserError(
            "the axes of the bank are in disorder",
            file=file,
            field="wavelengths_nm, field_x_deg, field_y_deg, reference_nm",
            allowed="rising, the reference among the wavelengths",
        )
