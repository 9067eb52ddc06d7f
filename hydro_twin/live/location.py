"""Where a fault enters a plant, in words: the value that an event and diagnostics carry."""
from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Location:
    """The ports at which an unknown input explains an innovation.

    Attributes:
        ports: their names, the likeliest first; more than one where the data do not distinguish
            them, none where no port explains it.
        meaning: of the first.
        gain: by how much it is likelier than the model as it is [nat].
        others: all ports but the first, with how much less likely each is than that [nat].
    """

    ports: tuple[str, ...] = ()
    meaning: str = ''
    gain: float = 0.0
    others: tuple[tuple[str, float], ...] = ()

    def __str__(self) -> str:
        """Say it in words, of a fault."""
        if not self.ports:
            return 'is not located'
        return f'enters at {" or ".join(self.ports)} ({self.meaning})'
