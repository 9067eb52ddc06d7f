"""What a model has been found to lack, and how much each effect explains."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from hydro_twin.effects import Placed
from hydro_twin.fitting.fit import Fit
from hydro_twin.inference.criterion import delta_bic, gain_p_value
from hydro_twin.inference.noise import noise_floor
from hydro_twin.inference.select import Alternative

TRIED = 40              # hypotheses of a round, for the correction: no plant has more effects at
#                         their ports and parameters that may drift


@dataclass(frozen=True)
class Finding:
    """One effect that earned its place.

    Attributes:
        index: of the effect in the candidate.
        p_value: of its likelihood ratio, corrected for all that was tried.
        share: of the mean square error without it that it removes.
        rivals: other effects in its place with their delta BIC, best first.
        doubt: probability that it does not help on held-out data, where these do not prove it.
        supported: whether it explains half of what is above the noise without it, where structure
            remains.
    """

    index: int
    p_value: float
    share: float
    rivals: tuple[tuple[Placed, float], ...]
    doubt: float = 0.0
    supported: bool = True


@dataclass(frozen=True)
class Selection:
    """A model as far as it has grown."""

    fit: Fit
    findings: tuple[Finding, ...] = ()

    @property
    def indices(self) -> list[int]:
        """Of its effects in the candidate."""
        return [found.index for found in self.findings]


def finding(without: Fit, fit: Fit, others: Sequence[tuple[Placed, Fit]], index: int) -> Finding:
    """Describe an effect against the fit without it, and against others in its place.

    Args:
        without: the fit without the effect.
        fit: the fit with it.
        others: another effect and the fit with it instead, each.
        index: of the effect.
    """
    score, *scores = delta_bic([fit, *(other for _, other in others)])
    return Finding(
        index=index, p_value=gain_p_value(without, fit, TRIED),
        share=share(without, fit),
        rivals=tuple(sorted(((placed, s - score) for (placed, _), s in zip(
            others, scores, strict=True)), key=lambda rival: rival[1])))


def best_finding(without: Fit, alternatives: Sequence[Alternative]) -> Finding:
    """Describe the effect that the first of some alternatives adds; the others are its rivals."""
    first, *others = alternatives
    return finding(without, first.fit, in_place(others), len(without.candidate.effects))


def in_place(alternatives: Sequence[Alternative]) -> list[tuple[Placed, Fit]]:
    """List what each alternative adds, and its fit."""
    return [(alternative.placed, alternative.fit) for alternative in alternatives]


def other_findings(selection: Selection, k: int) -> tuple[Finding, ...]:
    """List the findings but one, as they are without its effect."""
    gone = selection.findings[k].index
    return tuple(replace(found, index=found.index - (found.index > gone))
                 for found in (*selection.findings[:k], *selection.findings[k + 1:]))


def share(before: Fit, after: Fit) -> float:
    """Share of the mean square error that a later fit removes."""
    return 1.0 - (after.error / max(before.error, 1e-300)) ** 2


def explained_share(before: Fit, after: Fit) -> float:
    """Share of the mean square error above the noise floor that a later fit removes."""
    floor = noise_floor(after.by_part)
    return (before.error**2 - after.error**2) / max(before.error**2 - floor**2, 1e-300)
