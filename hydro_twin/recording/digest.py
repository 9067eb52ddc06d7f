"""Identifies a file or bag by its SHA-256."""
from __future__ import annotations

import hashlib
from pathlib import Path

from hydro_twin.recording.series import Source


def source_of(path: Path) -> Source:
    """Hash a file, or all the files of a folder.

    A file has its plain SHA-256, as sha256sum gives it. That of a folder is the SHA-256 of the
    list that `sha256sum *` prints in it: sorted by name, a line `HASH  NAME` a file.
    """
    if path.is_file():
        return Source(str(path), _sha256(path))
    lines = ''.join(f'{_sha256(file)}  {file.relative_to(path).as_posix()}\n'
                    for file in sorted(path.rglob('*')) if file.is_file())
    return Source(str(path), hashlib.sha256(lines.encode()).hexdigest())


def _sha256(path: Path) -> str:
    """Hash one file, piece by piece."""
    with path.open('rb') as file:
        return hashlib.file_digest(file, 'sha256').hexdigest()
