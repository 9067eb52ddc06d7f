"""Result files, written whole or not at all."""
from __future__ import annotations

from pathlib import Path


def write_whole(path: Path, content: bytes) -> None:
    """Write a file beside its place, then move it there."""
    part = path.with_name(f'.{path.name}.part')
    part.write_bytes(content)
    part.replace(path)
