"""Chromium, for the tests of pages."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

BROWSER = "chromium-headless-shell"


@contextmanager
def chromium() -> Iterator[Callable[..., Any]]:
    """Yield what launches a browser with some arguments; all are closed in the end."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if (path := shutil.which(BROWSER)) is None:
        pytest.skip(f"{BROWSER} is not installed (Debian: apt-get install {BROWSER})")
    with sync_api.sync_playwright() as playwright:
        browsers = []

        def launch(*arguments: str) -> Any:
            given = {"executable_path": path, "args": [*arguments, "--no-sandbox"]}
            browsers.append(playwright.chromium.launch(**given))
            return browsers[-1]

        yield launch
        for browser in browsers:
            browser.close()
