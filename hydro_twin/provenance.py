"""Where a model came from, for its file."""
from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from hydro_twin.recording.series import Source


def provenance(bags: Sequence[Source], test_bags: Sequence[Source], seed: int, command: str
               ) -> dict[str, Any]:
    """Name the bags with their SHA-256, the command, the seed and the version of the software."""
    def listed(sources: Sequence[Source]) -> list[dict[str, str]]:
        return [{'path': source.path, 'sha256': source.sha256} for source in sources]

    return {'bags': listed(bags), 'test_bags': listed(test_bags), 'command': command,
            'seed': seed, 'version': version('hydro_twin')}
