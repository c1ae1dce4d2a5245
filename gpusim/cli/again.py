"""``gpusim render --from``: a raw made again of the JSON file beside it."""

from __future__ import annotations

import json
from pathlib import Path

from rich.console import Console

from gpusim.cli import screen
from gpusim.cli.files import staging
from gpusim.isp.develop import develop
from gpusim.isp.files import write_picture
from gpusim.library.again import made_raw
from gpusim.library.recipe import recipe_of_frame


def run(recipe: Path, out: Path, show: str) -> int:
    """Make the raw of a recipe again, in the folder `out`; return the exit code.

    Parameters
    ----------
    recipe : Path
    out : Path
    show : str
        "table", "json" or "nothing".

    Returns
    -------
    int
        1 where the raw is not the one of then, byte for byte.
    """
    with staging(out) as folder, screen.progress_bar(show != "nothing") as progress:
        found = made_raw(recipe, progress)
        raw = folder / found.name
        same = found.write(raw)
        names = [f"{raw.stem}.{suffix}" for suffix in ("png", "json")]
        write_picture(folder / names[0], develop(raw).picture)
        facts = {
            "same": same,
            "changed": list(found.changed),
            "files": [found.name, *names],
            "recipe": recipe_of_frame(found.frame, raw, found.taken, ev=found.ev),
        }
        (folder / names[1]).write_text(json.dumps(facts, indent=1, allow_nan=False) + "\n")
    if show == "json":
        print(json.dumps(facts, indent=1))
    elif show == "table":
        console = Console()
        verdict = "the same, byte for byte" if same else "NOT the one of then"
        lines = [f"{found.name} is {verdict}", *found.changed, f"files in {out}: {found.name}"]
        lines[-1] += "".join(f", {name}" for name in names)
        for line in lines:
            console.print(line, markup=False, highlight=False, soft_wrap=True)
    return 0 if same else 1
