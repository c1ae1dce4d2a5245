"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gpusim.errors import UserError

PREFIX, LOCK = ".gpusim-", ".lock"
JUST_MADE_S = 60.0  # between the making of a folder and its lock lie microseconds
# What a disk says when it takes no more: full, over quota, the file too large for it or for
# `ulimit -f`, broken, read-only.
DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)


@contextmanager
def staging(folder: Path, option: str = "--out") -> Iterator[Path]:
    """Yield a temporary folder inside `folder`, made if need be; its files move up at the end.

    Entering it before the work starts shows that the folder can be written. Where the work fails,
    the files that were in `folder` stay as they were. What runs left there that were killed is
    removed: a run holds a lock on a file in its folder, which the system frees when it ends.
    ``option`` is what a mistake is blamed on.

    Raises
    ------
    UserError
        If the folder cannot be made or written, is gone, or the disk is full.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sweep(folder)
        temporary = Path(tempfile.mkdtemp(prefix=PREFIX, dir=folder))
        lock = _locked(temporary / LOCK)
    except OSError as error:
        raise UserError(
            f"the output folder cannot be written: {error.strerror}",
            file=folder,
            field=option,
            allowed="a folder that you may write to, or a new one inside such a folder",
        ) from error
    UNFINISHED.add(temporary)
    try:
        yield temporary
        for file in temporary.iterdir():
            if file.name != LOCK:
                file.replace(folder / file.name)
    except OSError as error:
        gone = not temporary.is_dir()
        if error.errno not in DISK and not gone:
            raise
        reason = "the output folder was removed" if gone else error.strerror
        raise UserError(f"writing failed: {reason}", file=folder) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        UNFINISHED.discard(temporary)
        os.close(lock)


# Folders of this process that are not whole: what a run that is stopped removes.
UNFINISHED: set[Path] = set()


def sweep(folder: Path) -> None:
    """Remove the temporary folders of runs that were killed."""
    for left in folder.glob(f"{PREFIX}*"):
        try:
            lock = os.open(left / LOCK, os.O_RDWR)
        except FileNotFoundError:
            # None yet, or of a time before there were locks.
            if left.is_dir() and time.time() - left.stat().st_mtime > JUST_MADE_S:
                shutil.rmtree(left, ignore_errors=True)
            continue
        except OSError:
            continue  # somebody else's
        try:
            if _lock(lock):
                shutil.rmtree(left, ignore_errors=True)
        finally:
            os.close(lock)


def _locked(file: Path) -> int:
    """Make a file and hold a lock on it until its descriptor is closed, or the process ends."""
    descriptor = os.open(file, os.O_RDWR | os.O_CREAT)
    _lock(descriptor)
    return descriptor


def _lock(descriptor: int) -> bool:
    """Lock an open file; tell whether nobody else holds it."""
    try:
        import fcntl
    except ImportError:  # Windows: removing a folder with an open file fails there by itself
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return False
    return True


@contextmanager
def whole_file(file: Path, suffixes: tuple[str, ...], option: str = "--out") -> Iterator[Path]:
    """Yield a temporary name for `file`, which replaces `file` at the end.

    Raises
    ------
    UserError
        If `file` has none of `suffixes`, is a folder, or its folder cannot be written.
    """
    if file.suffix.lower() not in suffixes or file.is_dir():
        raise UserError(
            "the output file cannot have this name",
            field=option,
            value=file,
            allowed="a file name that ends in " + " or ".join(suffixes),
        )
    with staging(file.parent, option) as folder:
        yield folder / file.name
