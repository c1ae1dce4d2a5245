"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gpusim.errors import UserError


@contextmanager
def staging(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder inside `folder`, made if need be; its files move up at the end.

    Entering it before the work starts shows that the folder can be written. Where the work fails,
    the files that were in `folder` stay as they were.

    Raises
    ------
    UserError
        If the folder cannot be made or written, or the disk is full.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".gpusim-", dir=folder))
    except OSError as error:
        raise UserError(
            f"the output folder cannot be written: {error.strerror}",
            file=folder,
            field="--out",
            allowed="a folder that you may write to, or a new one inside such a folder",
        ) from error
    try:
        yield temporary
        for file in temporary.iterdir():
            file.replace(folder / file.name)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise UserError(f"writing failed: {error.strerror}", file=folder) from error
    finally:
        shutil.rmtree(temporary)


@contextmanager
def whole_file(file: Path, suffixes: tuple[str, ...]) -> Iterator[Path]:
    """Yield a temporary name for `file`, which replaces `file` at the end.

    Raises
    ------
    UserError
        If `file` has none of `suffixes`, is a folder, or its folder cannot be written.
    """
    if file.suffix.lower() not in suffixes or file.is_dir():
        raise UserError(
            "the output file cannot have this name",
            field="--out",
            value=file,
            allowed="a file name that ends in " + " or ".join(suffixes),
        )
    with staging(file.parent) as folder:
        yield folder / file.name
