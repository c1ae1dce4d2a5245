"""What files of banks hold: of every variable its dimensions, its unit and its meaning."""

from __future__ import annotations

from gpusim.psf.store import Table, Variables

_FIELD = ("field",)
_GRID = ("field_y", "field_x")
_LINE = ("wavelength",)


def _shared(fields: tuple[str, ...]) -> Variables:
    """Return the variables that every bank has, over these dimensions of the field."""
    lines = (*fields, *_LINE)
    return {
        "wavelengths_nm": (_LINE, "nm", "wavelength"),
        "transmission": (_LINE, "1", "product of the surfaces' transmittances on axis"),
        "folded_energy": (
            lines,
            "1",
            "share of rays beyond the sampled pupil's period, which the PSFs leave to the halo",
        ),
        "fit_residual_waves": (
            lines,
            "1",
            "RMS difference of the fitted wavefront from the traced rays, in waves",
        ),
    }


def _optional(fields: tuple[str, ...], samples: tuple[str, str]) -> Variables:
    """Return the variables that any bank may have.

    The light beyond the window, which ready-made banks do not know; and the principal distance,
    which is the focal length where lens and object are set to infinity.
    """
    lines = (*fields, *_LINE)
    return {
        "halo": (
            ("level", *lines, *samples),
            "1",
            "share of the light per sample on coarser levels, beyond what the psf and the levels "
            "before hold: see gpusim.psf.halo",
        ),
        "halo_pitch_um": (("level",), "um", "spacing of a level's samples"),
        "beyond_energy": (lines, "1", "share of the light beyond the last level"),
        "halo_misfit": (
            lines,
            "1",
            "light that window and levels together had too much of, before that was made up around "
            "the core",
        ),
        "principal_mm": (
            (),
            "mm",
            "principal distance: paraxial image height over tan(theta), at the reference "
            "wavelength",
        ),
    }


_SCALARS = {
    "reference_nm": ("nm", "wavelength whose chief ray defines the real plane"),
    "pitch_um": ("um", "spacing of the PSF samples"),
}
_OF_FIELD = (*_FIELD, *_LINE)
RADIAL = Table(
    variables={
        **_shared(_FIELD),
        "field_deg": (_FIELD, "degree", "field angle in object space"),
        "ideal_height_um": (
            _FIELD,
            "um",
            "distortion-free image height, the principal distance times tan(theta); infinite from "
            "90 degrees",
        ),
        "real_height_um": (_OF_FIELD, "um", "height where the chief ray lands"),
        "psf": (
            (*_OF_FIELD, "eta", "xi"),
            "1",
            "share of the light per sample; row eta sagittal, column xi tangential, away from the "
            "axis; centred on the chief ray of its own wavelength; upright image; 0 outside the "
            "circle in the window",
        ),
        "relative_illumination": (_OF_FIELD, "1", "what an even scene shows, over that on axis"),
        "projected_solid_angle_sr": (
            _LINE,
            "sr",
            "what an even scene of unit radiance shows on axis: integral of d alpha d beta over "
            "the light that arrives there (pi sin^2 theta'), times what an apodised stop passes",
        ),
        "outside_energy": (
            _OF_FIELD,
            "1",
            "share of the light outside the circle in the PSF window",
        ),
        "failed_rays": (
            _OF_FIELD,
            "1",
            "rays aimed within the stop that missed a surface or were totally reflected",
        ),
    },
    optional={
        **_optional(_FIELD, ("halo_eta", "halo_xi")),
        # A file that lacks it: cubic.
        "spectral_degree": (
            (),
            "1",
            "between wavelengths: 3 cubic splines in 1 / lambda, 1 straight lines in lambda",
        ),
        # Where the rays are known: a ready-made bank may lack them.
        "chief": (
            (*_OF_FIELD, "direction"),
            "1",
            "direction cosines of the chief ray at the image, tangential (xi) and sagittal (eta)",
        ),
        "cone": (
            (*_OF_FIELD, "cell", "part"),
            "1",
            "rays that arrive: direction cosines, tangential (xi) and sagittal (eta), and share of "
            "the projected solid angle",
        ),
        # Where chief rays are known between the fields: else those of the fields are all.
        "ray_deg": (
            ("ray",),
            "degree",
            "field angle of chief rays, those of the fields among them",
        ),
        "ray_um": (("ray", "wavelength"), "um", "height where they land"),
        # Where the light that enters is known: a ready-made bank has none.
        "field_light": (
            _OF_FIELD,
            "1",
            "what an even scene sends through the lens about a field, per area of its image, over "
            "projected_solid_angle_sr",
        ),
    },
    scalars={
        **_SCALARS,
        "efl_mm": ("mm", "paraxial focal length at the reference wavelength"),
        "f_number": ("1", "focal length over entrance pupil diameter, at the reference wavelength"),
    },
)
_OF_GRID = (*_GRID, *_LINE)
PLANE = Table(
    variables={
        **_shared(_GRID),
        "field_x_deg": (("field_x",), "degree", "field angle along x"),
        "field_y_deg": (("field_y",), "degree", "field angle along y"),
        "chief_x_um": (_OF_GRID, "um", "where the chief ray lands, x"),
        "chief_y_um": (_OF_GRID, "um", "where the chief ray lands, y"),
        "psf": (
            (*_OF_GRID, "y", "x"),
            "1",
            "share of the light per sample; centred on the chief ray of its own wavelength; "
            "upright image",
        ),
        "relative_illumination": (
            _OF_GRID,
            "1",
            "what an even scene sends through the lens about a field, per area of its image, over "
            "that of field 0, 0",
        ),
        "projected_solid_angle_sr": (
            _LINE,
            "sr",
            "what an even scene of unit radiance sends through about field 0, 0, per area of its "
            "image",
        ),
        "outside_energy": (_OF_GRID, "1", "share of the light outside the PSF window"),
        "failed_rays": (_OF_GRID, "1", "rays aimed within the stop that did not reach the image"),
        "ray_x_deg": (("ray",), "degree", "field angle along x of the chief rays of the map"),
        "ray_y_deg": (("ray",), "degree", "field angle along y of the chief rays of the map"),
        "ray_x_um": (("ray",), "um", "where they land at the reference wavelength, x"),
        "ray_y_um": (("ray",), "um", "where they land at the reference wavelength, y"),
    },
    optional={
        **_optional(_GRID, ("halo_y", "halo_x")),
        # Where the rays are known.
        "chief": (
            (*_OF_GRID, "direction"),
            "1",
            "direction cosines of the chief ray at the image, along x and y",
        ),
        "cone": (
            (*_OF_GRID, "cell", "part"),
            "1",
            "rays that arrive: direction cosines along x and y, and share of the projected solid "
            "angle",
        ),
    },
    scalars={
        **_SCALARS,
        "efl_mm": ("mm", "paraxial focal length of the centred lens at the reference wavelength"),
        "f_number": ("1", "focal length over entrance pupil diameter, of the centred lens"),
    },
)
