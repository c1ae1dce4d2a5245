"""``gpusim devices``."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from gpusim.gpu import default_device, devices


def run() -> None:
    """List the adapters, and what the one that would be used offers."""
    chosen = default_device().report()
    console = Console()
    adapters = Table("", "adapter", "driver", "backend", "type", box=None, header_style="bold")
    for device in devices():
        used = all(device[key] == chosen[key] for key in device)
        adapters.add_row(
            "*" if used else "",
            device["adapter"],
            device["driver"],
            device["backend"],
            device["type"],
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
