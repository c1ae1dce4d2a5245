"""The methods by which a scale may be convolved: the same model, each with a pass of its own."""

from __future__ import annotations

from gpusim.errors import UserError
from gpusim.gpu import Device
from gpusim.optics.convolve import Convolve
from gpusim.optics.direct import Direct
from gpusim.optics.modes import Modes, mode_decomposition
from gpusim.optics.nodes import Scale
from gpusim.sensor.aperture import Response

METHODS = ("fft", "direct", "modes")
Convolution = Convolve | Direct | Modes


def check_method(method: str | None) -> None:
    """Raise a UserError for a name that is none of METHODS; None leaves the choice to the plan."""
    if method not in (None, *METHODS):
        raise UserError(
            "There is no such method.", field="method", value=method, allowed=", ".join(METHODS)
        )


def convolution(
    device: Device,
    scale: Scale,
    needed: dict[tuple[int, int], int],
    aperture_um: float | Response,
    site_channels: list[int],
) -> Convolution:
    """Return the passes of a scale's method; kernels come onto the device as it loads them.

    Parameters
    ----------
    device : Device
    scale : Scale
    needed : dict
        Coefficient planes that each block needs.
    aperture_um : float or Response
        Side of the square pixel aperture, or any other's response.
    site_channels : list of int
        Colour channel of each CFA site, row by row.
    """
    common = (device, scale, needed, aperture_um, site_channels)
    if scale.method == "direct":
        return Direct(*common, support=scale.support)
    if scale.method == "modes":
        planes = max(needed.values(), default=0)
        whole = mode_decomposition(
            scale.kernels, scale.grid, scale.pitch_um, scale.map_cells, max(planes, 1)
        )
        rank, _ = whole.rank_within(scale.rank_error)
        return Modes(*common, decomposition=whole.truncated(rank))
    return Convolve(*common)
