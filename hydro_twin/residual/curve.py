"""What no effect explains: a free curve at the port and over the signal where it helps most."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from hydro_twin.effects import Placed
from hydro_twin.effects.curve import curve
from hydro_twin.fitting.candidate import Candidate, Part
from hydro_twin.fitting.free_run import Fit
from hydro_twin.residual.proof import Improvement, improvement
from hydro_twin.residual.select import criterion, far, gain_p_value, search
from hydro_twin.residual.structure import Dependence

MOST = 6                # dependences that are fitted in full
STEPS = 40              # of each fit
LEVEL = 1e-3            # of its test, corrected for all dependences tried
SAME = 1.0              # distance of the criterion within which two curves are one
STRENGTHS = (1.0, 0.3, 0.1)     # of the curve that the linear laws suggest, to begin at


@dataclass(frozen=True)
class Found:
    """A curve that improves a model, fitted in full with all of its parameters.

    Attributes:
        fit: its last effect is the curve.
        proof: what it improves on data that was not fitted.
        p_value: of what it adds, for all that was tried.
        others: curves elsewhere, and how much worse they are by the criterion, nearest first.
    """

    fit: Fit
    proof: Improvement
    p_value: float
    others: tuple[tuple[Placed, float], ...]

    @property
    def placed(self) -> Placed:
        """The curve."""
        return self.fit.candidate.effects[-1]


def find_curve(fit: Fit, parts: Sequence[Part], unseen: Sequence[Part],
               depends_on: Sequence[Dependence], seed: int) -> Found | None:
    """Fit a curve at each port and signal that a residual depends on; the best, if it helps.

    Args:
        fit: the model that leaves something.
        parts: what it was fitted to.
        unseen: what it was not.
        depends_on: what its residual depends on, the strongest first.
        seed: of the bootstrap.

    Returns:
        None where no curve makes the free run better on data that was not fitted.
    """
    fits = [search(_begin(fit.candidate, dependence, parts), parts, STEPS)
            for dependence in depends_on[:MOST]]
    if not fits:
        return None
    scores = criterion(fits)
    best = min(scores)
    # The value of a port is often a multiple of a signal there, which says more.
    order = sorted(range(len(fits)), key=lambda k: (
        scores[k] > best + SAME, _signal(fits[k]) == 'value', scores[k]))
    found = fits[order[0]]
    p_value = gain_p_value(fit, found, len(fits))
    proof = improvement([fit.candidate.residual(p) for p in unseen],
                        [found.candidate.residual(p) for p in unseen], seed)
    if p_value > LEVEL or proof.low <= 0.0:
        return None
    others = sorted(((fits[k].candidate.effects[-1], scores[k] - scores[order[0]])
                     for k in order[1:]), key=lambda other: other[1])
    return Found(found, proof, p_value, tuple(others))


def _signal(fit: Fit) -> str:
    return fit.candidate.effects[-1].effect.reads[0]


def _begin(candidate: Candidate, dependence: Dependence, parts: Sequence[Part]) -> Candidate:
    """Add the curve of a dependence, as strong as helps at once."""
    tried = [replace(candidate, effects=(*candidate.effects, curve(
        dependence.port, dependence.signal, float(dependence.knots[0]),
        float(dependence.knots[-1]), strength * dependence.curve))) for strength in STRENGTHS]
    return min(tried, key=lambda c: far(c, parts))
