"""How probable each explanation of a residual is: named effects, a law that is not known, nothing.

Between effects in one place the posterior decides, coarsened: no model is exactly the rig, so that
a difference of BIC counts as if there were at most `SAMPLES` of them [Miller and Dunson 2019].
That the law of none of them is the rig's cannot be computed from them. Its probability is how
often it was so among the development rigs, laws outside the library among them, given what the
tests of the residual say (`python -m benchmarks.tracing.calibrate`).
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

from hydro_twin.result import NamedEffect, VerdictKind

SAMPLES = 1000.0        # as many decide between two laws: 20 of BIC, of 3000 samples, is 7 %
# Share of the development rigs on which the law was another than those named ...
P_OTHER_LAW_CLEAN = 0.005      # ... where no test found anything in the residual
P_OTHER_LAW_STRUCTURED = 0.05  # ... where one did
P_OTHER_LAW_NOISY = 0.15       # ... where more is left than noise, or a free curve stands beside
P_OTHER_LAW_FAILS = 0.25       # ... where the model fails on held-out data
P_OTHER_LAW_MISFIT = 0.65      # ... and where much is left that cannot be noise
# Share on which an effect showed although nothing was found, and none although something was left.
P_MISSED = 0.15
P_MISSED_COLOURED = 0.5        # the first, where more is left than noise of a short memory
P_FALSE_STRUCTURE = 0.05


def coarsened_posterior(distances: Mapping[str, float], samples: int) -> dict[str, float]:
    """Share a probability out among explanations.

    Args:
        distances: their BIC over that of the one preferred; below zero counts as zero.
        samples: that were fitted.
    """
    temper = SAMPLES / (SAMPLES + samples)
    weights = {name: math.exp(-0.5 * temper * max(distance, 0.0))
               for name, distance in distances.items()}
    total = sum(weights.values())
    return {name: weight / total for name, weight in weights.items()}


def min_null_probability(p_value: float) -> float:
    """Return the least probability that an effect with this p-value is chance.

    1 / (1 + 1 / (-e p ln p)), even odds before [Sellke, Bayarri and Berger 2001].
    """
    if not 0.0 < p_value < 1.0 / math.e:
        return 0.0 if p_value <= 0.0 else 0.5
    bound = -math.e * p_value * math.log(p_value)
    return bound / (1.0 + bound)


def of_verdict(verdict: VerdictKind, effects: Sequence[NamedEffect], much: bool
               ) -> tuple[float, float]:
    """Return the probabilities that nothing is missing and that an unknown law is missing.

    The named effects have the remaining probability.

    Args:
        verdict: what was found.
        effects: that were named.
        much: whether more is left than white noise, or noise of a short memory.
    """
    if verdict == 'nothing_missing':
        missed = P_MISSED_COLOURED if much else P_MISSED
        return 1.0 - missed, missed
    if verdict == 'unexplained':
        return P_FALSE_STRUCTURE, 1.0 - P_FALSE_STRUCTURE
    nothing = min(min_null_probability(effect.p_value) for effect in effects)
    return nothing, (1.0 - nothing) * max(effect.law_unknown for effect in effects)
