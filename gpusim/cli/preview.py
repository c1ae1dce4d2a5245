"""``gpusim preview``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path


def run(
    camera: str,
    scene: str,
    knobs: Mapping[str, object],
    *,
    out: Path,
    screenshot: Path | None,
    script: Path | None,
) -> None:
    """Open the preview; or, without a window, play a script and save the screen."""
    from gpusim.preview.window import Offscreen, check_packages, show, turned

    check_packages()
    chosen = turned(camera, scene, knobs)
    if screenshot is None and script is None:
        show(chosen, out)
        return
    from gpusim.preview.script import play, read_script, save_screen

    steps = [] if script is None else read_script(script)
    screen = Offscreen(chosen, out)
    try:
        play(screen, steps or [{"wait": "draft"}, {"wait": "refined"}])
        if screenshot is not None:
            save_screen(screen, screenshot)
            print(screenshot)
    finally:
        screen.close()
