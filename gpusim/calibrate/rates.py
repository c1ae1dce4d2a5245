"""Measure an adapter's rates for the cost model, once, and keep them in the user's cache."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from pathlib import Path

from gpusim.cache import cache_folder
from gpusim.calibrate.optics_rates import (
    host_rates,
    other_rates,
    point_source_rates,
    source_rates,
    transform_rates,
)
from gpusim.calibrate.sensor_rates import ccd_rates, dispatch_rates, sensor_rates
from gpusim.config.text import read_json
from gpusim.disk import whole
from gpusim.errors import UserError
from gpusim.gpu import Device
from gpusim.gpu.wgsl import shaders_sha256
from gpusim.plan.blocks import TRANSFORMS
from gpusim.plan.costs import Costs, content_of, costs_of

TURNS = 2  # in which everything is timed; the first also compiles
PARTS = (
    host_rates,
    point_source_rates,
    source_rates,
    transform_rates,
    other_rates,
    sensor_rates,
    ccd_rates,
    dispatch_rates,
)
Progress = Callable[[int, int], None]


def adapter_costs(
    device: Device, *, again: bool = False, progress: Progress | None = None
) -> Costs:
    """Return the rates of a device, from the cache or measured now.

    Parameters
    ----------
    device : Device
    again : bool
        Measure even if the cache has them.
    progress : callable, optional
        Called with (measurements done, measurements in all).

    Notes
    -----
    The cache is the folder ``costs`` of `gpusim.cache`. The key is a hash of the adapter, its
    driver, the shaders and the files of this package. Where the cache cannot be written the rates
    are measured every time.
    """
    path = _path(device)
    found = None if again else _read(path)
    if found is None:
        found = measure(device, progress)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with whole(path) as part:
                part.write_text(json.dumps(content_of(found), indent=1))
        except OSError:
            pass  # the next process measures again
    return found


def cached_costs(device: Device) -> Costs | None:
    """Return the rates of a device if they were measured before."""
    return _read(_path(device))


def _path(device: Device) -> Path:
    report = device.report()
    digest = hashlib.sha256(shaders_sha256().encode())
    for file in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(file.read_bytes())
    for name in ("adapter", "driver", "backend", "wgpu"):
        digest.update(str(report[name]).encode() + b"\0")
    return cache_folder("costs") / f"{digest.hexdigest()[:32]}.json"


def _read(path: Path) -> Costs | None:
    """Return what a file holds, or None if it is no whole set of rates."""
    try:
        return costs_of(read_json(path, "the rates"))
    except (UserError, ValueError):
        return None


def planned_costs(file: Path) -> Costs:
    """Return the rates that the plan of a report was made from: they make the same plan again.

    Raises
    ------
    UserError
        The file is no report of a render, or its rates are none.
    """
    report = read_json(file, "the report")
    try:
        return costs_of(report["costs"] if isinstance(report, dict) else None)
    except (KeyError, ValueError) as error:
        raise UserError(
            "the file does not say which rates its plan was made from",
            file=file,
            field="costs",
            value=str(error),
            allowed="a report.json that gpusim render wrote",
        ) from error


def measure(device: Device, progress: Progress | None = None) -> Costs:
    """Time every stage on a small piece of its work.

    All are timed in turns, and each counts as in the turn that it took least time in: a plan weighs
    them against one another, and a machine with other work runs now faster and now slower.
    """
    tell = progress or (lambda done, total: None)
    best: dict[Callable, tuple[float, dict[str | int, float]]] = {}
    for number, part in enumerate(TURNS * PARTS):
        tell(number, TURNS * len(PARTS))
        started = time.perf_counter()
        rates = part(device)
        spent = time.perf_counter() - started
        if part not in best or spent < best[part][0]:
            best[part] = (spent, rates)
    tell(TURNS * len(PARTS), TURNS * len(PARTS))
    ns: dict[str, float] = {}
    lengths: dict[int, float] = {}
    for _, rates in best.values():
        lengths |= {key: float(rates.pop(key)) for key in TRANSFORMS if key in rates}
        ns |= {name: float(rate) for name, rate in rates.items()}
    return Costs(f"measured on {device.report()['adapter']}", ns, lengths)
