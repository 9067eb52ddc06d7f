"""Files that are written atomically: complete, or not at all."""
from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import errno
import os
from pathlib import Path


@contextmanager
def named_in_errors(path: Path) -> Iterator[None]:
    """Name a file in what the system reports while it is written, as that the disk is full."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)
        raise


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a path beside a file to write to; it takes the file's place when all is written.

    Where the writing fails, or is interrupted, the file stays as it was.

    Raises:
        OSError: the file cannot be put there; it names the file, not the one written to.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not path.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    part = path.with_name(f'.{path.name}.{os.getpid()}')
    try:
        with named_in_errors(path):
            yield part
            part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def write_whole(path: Path, content: bytes | str, *, durable: bool = False) -> None:
    """Write a file atomically.

    Args:
        path: of the file.
        content: of the file, text in UTF-8.
        durable: have it on the disk before this returns.

    Raises:
        OSError: the file cannot be written there.
    """
    with written_whole(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)
        if durable:
            sync(part)
    if durable:
        sync(path.parent)


def sync(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk.

    Raises:
        OSError: it is not there, or the disk fails.
    """
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
