"""Every fact about a capture, in JSON types."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

import gpusim
from gpusim.config.plain import plain
from gpusim.gpu.wgsl import shaders_sha256
from gpusim.isp.levels import iso_speed, saturated_share
from gpusim.plan.costs import content_of
from gpusim.render.recipe import PACKAGES
from gpusim.report.histogram import histogram_facts
from gpusim.scene import Chart
from gpusim.scene.spectra import STEP_NM

if TYPE_CHECKING:
    from gpusim.camera import Camera
    from gpusim.plan import Plan
    from gpusim.plan.band import Band
    from gpusim.render import Capture
    from gpusim.scene import Scene


def facts(capture: Capture, *, files: Sequence[str], command: Sequence[str]) -> dict[str, Any]:
    """Return everything that is known about a capture, in JSON types only.

    Parameters
    ----------
    capture : Capture
        What was rendered, with its plan, times and certificate.
    files : sequence of str
        Names of the files that lie beside the report.
    command : sequence of str
        The command line that asked for it.

    Returns
    -------
    dict
        Every parameter, the seed, adapter and driver, versions, plan, times [s] and certificate.
    """
    first_row, first_col, rows, cols = capture.areas.lit
    return {
        "gpusim": gpusim.__version__,
        "created": f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC",
        "command": list(command),
        "capture": {
            "rows": rows,
            "cols": cols,
            "first_row": first_row,
            "first_col": first_col,
            "raw_rows": capture.raw.shape[0],
            "raw_cols": capture.raw.shape[1],
            "exposure_s": float(capture.exposure_s),
            "temperature_c": float(capture.temperature_c),
            "seed": capture.seed,
            "frame": capture.frame,
            "wall_s": float(capture.wall_s),
            "tolerance": capture.accuracy.tolerance,
            "tolerance_unit": capture.accuracy.unit,
            "best_effort": capture.accuracy.best_effort,
            "aim": capture.accuracy.aim,
            "saturated_share": _saturated(capture),
            "iso": iso_speed(capture.camera.sensor),
            "raw_sha256": hashlib.sha256(np.ascontiguousarray(capture.raw)).hexdigest(),
        },
        "histogram": histogram_facts(capture),
        "camera": _camera(capture.camera),
        "scene": {**_scene(capture.scene), "notes": plain(capture.notes)},
        "device": plain(capture.device),
        "versions": {
            "python": platform.python_version(),
            "system": platform.platform(),
            **{name: metadata.version(name) for name in PACKAGES},
        },
        "shaders_sha256": shaders_sha256(),
        "wavelengths": _wavelengths(capture.band),
        "plan": _plan(capture.plan),
        "costs": None if capture.costs is None else plain(content_of(capture.costs)),
        "qe_by_place": _qe_by_place(capture),
        "memory": plain(capture.memory),
        "work": plain(capture.work),
        "prepare_s": plain(capture.prepare_s),
        "times_s": plain(capture.times_s),
        "certificate": plain(capture.certificate),
        "files": list(files),
    }


def _saturated(capture: Capture) -> float:
    """Return the share of the lit pixels that are saturated."""
    row, col, rows, cols = capture.areas.active
    lit = capture.raw[row : row + rows, col : col + cols]
    return saturated_share(lit, capture.camera.sensor) if lit.size else 0.0


def _camera(camera: Camera) -> dict[str, Any]:
    lens = plain(camera.lens.model_dump())
    changes = plain(camera.lens.history)
    return {
        "title": camera.title,
        "lens": {**lens, "changes": changes},
        "sensor": plain(camera.sensor.model_dump()),
    }


def _qe_by_place(capture: Capture) -> dict[str, Any] | None:
    """Return the quantum efficiency over the field, of sensors that have one by angle."""
    if capture.camera.sensor.eqe_map is None:
        return None
    from gpusim.report.qe_figure import qe_facts

    return qe_facts(capture.plan.basis.elsewhere.response, capture.camera.sensor)


def _scene(scene: Scene) -> dict[str, Any]:
    if isinstance(scene.source, Chart):
        content = {"kind": "chart", "primitives": len(scene.source.primitives)}
    else:
        content = {"kind": "raster", "planes_rows_cols": list(scene.source.planes.shape)}
    return {
        "name": scene.name,
        **content,
        "spectra": len(scene.spectra),
        "illuminant": scene.illuminant,
        "illumination": scene.illumination,
        "white_luminance_cd_m2": scene.white_luminance_cd_m2,
    }


def _wavelengths(band: Band) -> dict[str, Any]:
    """Return what of the spectrum was rendered, and what no data describe."""
    first, last = band.wavelengths_nm[[0, -1]]
    return {
        "first_nm": float(first),
        "last_nm": float(last),
        "step_nm": STEP_NM,
        "dropped_share": band.dropped,
        "no_data": [{**plain(one), "text": one.text} for one in band.unknown],
    }


def _plan(plan: Plan) -> dict[str, Any]:
    scales = [
        {
            "name": scale.name,
            "pitch_um": float(scale.pitch_um),
            "low_pass_sigma_samples": float(scale.sigma),
            **plain(scale.grid),
        }
        for scale in plan.scales
    ]
    planes = plan.basis.coefficients.shape[1]
    return {
        "name": plan.name,
        "predicted_s": float(plan.predicted_s),
        "rates": plan.rates,
        "planes": planes,
        "scales": scales,
        "stages": plain(plan.stages),
        "tolerance": float(plan.tolerance),
        "shortfall": plan.shortfall,
        "runners_up": plain(plan.runners_up),
    }
