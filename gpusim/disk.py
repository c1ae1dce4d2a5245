"""Files that take their places at once: a worker that is killed leaves the old one, or the new."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def beside(path: Path) -> Path:
    """Return the name under which a file is written, beside its place."""
    return path.with_name(f".{os.getpid()}-{path.name}")


def put(part: Path, path: Path) -> None:
    """Put a file into its place, once it is on disk."""
    with part.open("rb") as file:
        os.fsync(file.fileno())
    os.replace(part, path)


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yield a name beside a file, which takes the file's place once it is written and on disk."""
    part = beside(path)
    try:
        yield part
        put(part, path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Wait until no other worker holds a file, and hold it; the system frees it after a kill."""
    with path.open("w") as lock:
        try:
            import fcntl
        except ImportError:  # Windows: two workers may make a light twice, with the same bytes
            pass
        else:
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield
