"""Keeps what traces found: a folder each, under the digest of all that went into it.

A folder is made beside its place and renamed when it is whole. So a trace is there with all its
files or not at all, whoever is killed; and one that is there need not be made again.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cache
import hashlib
from importlib.metadata import version
import json
import os
from pathlib import Path
import shutil
import socket
from threading import get_ident
from typing import Any

from hydro_twin.compiled import sources
from hydro_twin.plugins import plugin_files
from hydro_twin.recording.rig import Rig
from hydro_twin.recording.series import Source

RESULTS = 'results'
FORMAT = 3                  # of the record
RECORD = 'result.json'      # what the tables are made of; the other files are those of a trace


def key_of(bags: Sequence[Source], rig: Rig, seed: int) -> str:
    """Digest what the result of a trace depends on; returns 32 hexadecimal digits.

    That is what the bags hold, in their order, but not where they are; what is known of the rig;
    the seed; the version, with the laws of the effects and the plants of other packages.
    """
    inputs = {
        'bags': [bag.sha256 for bag in bags], 'plant': rig.plant.name,
        'constants': rig.constants, 'clock': asdict(rig.clock),
        'signals': {name: asdict(where) for name, where in (rig.signals | rig.sensors).items()},
        'seed': seed, 'format': FORMAT, 'version': version('hydro_twin'), 'laws': _laws(),
    }
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()[:32]


@cache
def _laws() -> str:
    """Digest the sources of the effects, and of the plants of other packages."""
    digest = hashlib.sha256()
    for path in [*sources(), *plugin_files('hydro_twin.plants')]:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def keys(folder: Path) -> set[str]:
    """Return the keys of the results that are there."""
    return {path.parent.name for path in (folder / RESULTS).glob(f'*/{RECORD}')}


def find(folder: Path, key: str) -> dict[str, Any] | None:
    """Return the record of a result; None if it is not there."""
    try:
        record: dict[str, Any] = json.loads(
            (folder / RESULTS / key / RECORD).read_text(encoding='utf-8'))
    except FileNotFoundError:
        return None
    return record


def keep(folder: Path, key: str, write: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    """Write a result atomically.

    Args:
        folder: of the fleet.
        key: of the result.
        write: fills a folder, and returns the record.

    Returns:
        The record; that of another who was faster, if one was.

    Raises:
        OSError: it cannot be written there.
    """
    place = folder / RESULTS / key
    part = place.with_name(f'.{key}.{get_ident()}.{os.getpid()}.{socket.gethostname()}')
    part.mkdir(parents=True)
    try:
        record = write(part)
        (part / RECORD).write_text(json.dumps(record, allow_nan=False), encoding='utf-8')
        try:
            part.rename(place)
        except OSError:                     # a folder that is not empty is not replaced
            if (there := find(folder, key)) is None:
                raise
            return there
        return record
    finally:
        shutil.rmtree(part, ignore_errors=True)


def sweep(folder: Path) -> None:
    """Remove what processes of this machine began and never finished, since they were killed."""
    for part in (folder / RESULTS).glob('.*.*.*.*'):
        _, process, host = part.name[1:].split('.', 3)[1:]
        if host == socket.gethostname() and not Path('/proc', process).exists():
            shutil.rmtree(part, ignore_errors=True)
