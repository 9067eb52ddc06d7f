"""The recordings that a model and those before it came from, as far as they are still there."""
from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from hydro_twin.recording.digest import source_of
from hydro_twin.recording.series import Source
from hydro_twin.store.store import Store
from hydro_twin.store.version import Version

LARGEST = 1 << 30       # bytes of all of them: some ten seconds to read and to hash


def sources(store: Store, version: Version) -> Iterator[Source]:
    """List what a version and its line of descent came from, the newest first.

    Raises:
        UserError: the store is damaged.
    """
    seen: set[str] = set()
    while True:
        bag = version.record.get('bag')
        given = ([{'path': str(store.path / bag['path']), 'sha256': bag['sha256']}] if bag else
                 version.model().record.provenance.get('bags', []))
        for one in given:
            if one['sha256'] not in seen:
                seen.add(one['sha256'])
                yield Source(one['path'], one['sha256'])
        if version.parent is None:
            return
        version = store.version(version.parent)


def recordings(store: Store, version: Version, most: int) -> list[Path]:
    """Find those of `sources` that are there as they were, the newest, so many at most.

    Raises:
        UserError: the store is damaged.
    """
    found: list[Path] = []
    left = LARGEST
    for source in sources(store, version):
        path = Path(source.path)
        if len(found) == most:
            break
        if not path.exists():
            continue
        size = sum(file.stat().st_size for file in [path, *path.rglob('*')] if file.is_file())
        if size <= left and source_of(path).sha256 == source.sha256:
            found.append(path)
            left -= size
    return found
