"""``gpusim devices``."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from gpusim.calibrate.rates import adapter_costs, cached_costs
from gpusim.cli.screen import progress_bar
from gpusim.gpu import default_device, devices
from gpusim.plan.costs import UNITS


def run(calibrate: bool) -> None:
    """List the adapters, what the one that would be used offers, and how fast it is."""
    device = default_device()
    if calibrate:
        with progress_bar() as progress:
            adapter_costs(
                device, again=True, progress=lambda done, total: progress("calibrate", done, total)
            )
    chosen = device.report()
    console = Console()
    adapters = Table("", "adapter", "driver", "backend", "type", box=None, header_style="bold")
    for one in devices():
        used = all(one[key] == chosen[key] for key in one)
        adapters.add_row(
            "*" if used else "",
            one["adapter"],
            one["driver"],
            one["backend"],
            one["type"],
        )
    console.print(adapters)
    console.print("\n* is used by default; --adapter NAME or GPUSIM_ADAPTER=NAME chooses another.")
    console.print("Limits, the same on every adapter:")
    limits = Table(box=None, show_header=False)
    for name, value in chosen["limits"].items():
        limits.add_row(name, f"{value:,}")
    limits.add_row("memory budget, bytes", f"{chosen['budget_bytes']:,}")
    limits.add_row("timestamps", "yes" if chosen["timestamps"] else "no, the wall clock serves")
    console.print(limits)
    costs = cached_costs(device)
    if costs is None:
        console.print("Rates for the planner: not measured yet; the first render does, or")
        console.print("gpusim devices --calibrate")
        return
    console.print("Rates for the planner, ns (gpusim devices --calibrate measures them again):")
    rates = Table(box=None, show_header=False)
    for name, unit in UNITS.items():
        rates.add_row(name, f"{costs.ns[name]:,.3g}", f"a {unit}")
    lengths = ", ".join(f"{length}: {factor:.2f}" for length, factor in costs.lengths.items())
    rates.add_row("by length", "", f"{lengths}, relative to transforms of 256")
    console.print(rates)
