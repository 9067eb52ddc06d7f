"""The data of a search for effects, and what has been fitted to them so far."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
import math

from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.parts import Part
from hydro_twin.inference.search import LONG, search_all
from hydro_twin.inference.select import Alternative, fit_alternatives
from hydro_twin.model import Model

EffectKeys = frozenset[tuple[str, str]]     # effects of a model by their `Placed.key`


@dataclass(frozen=True)
class Context:
    """The data of a search, and what has been fitted to them so far.

    Attributes:
        parts: the training data.
        held_out: the held-out data.
        times: stamps [s] of the first and the last sample of both.
        known: of each model, how many alternatives on top of it were asked for, up to which error
            they were searched to the end, and these.
        fits: the best fit with each set of effects.
    """

    parts: Sequence[Part]
    held_out: Sequence[Part]
    times: tuple[float, float]
    seed: int
    progress: Callable[[str], None]
    known: dict[tuple[EffectKeys, int], tuple[int, float, list[Alternative]]] = field(
        default_factory=dict)
    fits: dict[EffectKeys, Fit] = field(default_factory=dict)

    def fit_alternatives(self, fit: Fit, most: int, most_error: float = math.inf
                         ) -> list[Alternative]:
        """Fit effects on top of a fit, unless as many, searched as far, are known."""
        key = effects_of(fit.candidate), len(fit.unknowns)
        asked, limit, _ = self.known.get(key, (0, 0.0, []))
        if asked < most or limit < most_error:
            found = fit_alternatives(fit, self.parts, self.times, most, afresh=False,
                                     progress=self.progress, most_error=most_error)
            self.known[key] = most, most_error, found
            self.remember(*(alternative.fit for alternative in found))
        return self.known[key][2]

    def remember(self, *fits: Fit) -> None:
        """Keep each fit, unless a better one with the same effects is known."""
        for fit in fits:
            key = effects_of(fit.candidate)
            if key not in self.fits or fit.cost < self.fits[key].cost:
                self.fits[key] = fit

    def best(self, fit: Fit) -> Fit:
        """Return the best fit known with the effects of this one."""
        return min(fit, self.fits.get(effects_of(fit.candidate), fit), key=lambda f: f.cost)

    def without(self, fit: Fit, indices: Iterable[int]) -> list[Fit]:
        """Take each of some effects out by itself, and fit the rest again.

        From its present values and from those of the best fit known with the same effects: the
        values beside an effect are a poor start without it.
        """
        starts = []
        for index in indices:
            bare = fit.candidate.without(index)
            starts.append([bare])
            if known := self.fits.get(effects_of(bare)):
                placed = {p.key: p for p in known.candidate.effects}
                starts[-1].append(replace(
                    known.candidate, substeps=bare.substeps,
                    effects=tuple(placed[p.key] for p in bare.effects)))
        fits = search_all([start for some in starts for start in some], self.parts, LONG)
        best = [min(islice(fits, len(some)), key=lambda fit: fit.cost) for some in starts]
        self.remember(*best)
        return best


def effects_of(candidate: Model) -> EffectKeys:
    """Name the effects of a candidate with their ports, in whatever order."""
    return frozenset(placed.key for placed in candidate.effects)
