"""Which rigs there are: a seed stands for its kind, effects, excitation and noise."""
from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from benchmarks.tracing.lacking import EFFECTS, OUTSIDE, STATIC, VARIED
from benchmarks.tracing.rigs import make_rig, Rig
from benchmarks.tracing.signals import EXCITATIONS

KINDS = ('none', 'single', 'variant', 'outside', 'pair', 'static', 'triple')
SEVERAL = ('pair', 'triple')
NOISE_LEVELS = (46.0, 26.0, 36.0)
FIRST_SEED = {'development': 0, 'held_out': 1_000_000}
BLOCK = 2000    # seeds of a kind


def _together(count: int) -> list[tuple[str, ...]]:
    """List all sets of so many effects, in an order by chance."""
    every = list(combinations(EFFECTS, count))
    return [every[i] for i in np.random.default_rng(0).permutation(len(every))]


_CHOICES: dict[str, list[tuple[str, ...]]] = {
    'none': [()],
    'single': [(e,) for e in EFFECTS],
    'variant': [(e,) for e in VARIED],
    'outside': [(e,) for e in OUTSIDE],
    'pair': _together(2),
    'static': [(e,) for e in STATIC],
    'triple': _together(3),
}


@dataclass(frozen=True)
class Case:
    """One rig to trace; see make_rig."""

    seed: int
    kind: str
    effects: tuple[str, ...]
    excitation: str
    snr_db: float

    def rig(self, left_out: tuple[str, ...] = ()) -> Rig:
        """Draw the rig and record it."""
        return make_rig(self.seed, self.kind, self.effects, self.excitation, self.snr_db, left_out)


def case_of(seed: int) -> Case:
    """Return the case that a seed stands for."""
    block, index = divmod(seed % FIRST_SEED['held_out'], BLOCK)
    kind = KINDS[block]
    choices = _CHOICES[kind]
    turn, choice = divmod(index, len(choices))
    mix = turn + choice     # 4 excitations and 3 noise levels: 12 turns meet every combination
    return Case(seed, kind, choices[choice], EXCITATIONS[mix % len(EXCITATIONS)],
                NOISE_LEVELS[mix % len(NOISE_LEVELS)])


def cases(seeds: str, kind: str, count: int) -> list[Case]:
    """Return the first cases of a kind, of the 'development' or the 'held_out' seeds."""
    if count > BLOCK:
        raise ValueError(f'{count} cases of a kind asked for; there are {BLOCK}')
    first = FIRST_SEED[seeds] + BLOCK * KINDS.index(kind)
    return [case_of(seed) for seed in range(first, first + count)]
