"""The verdict: what may be said of a trace, and how certainly."""
from __future__ import annotations

from collections.abc import Mapping

from hydro_twin.effects import Placed, Span
from hydro_twin.fitting.conditional_estimates import conditional_on
from hydro_twin.inference.evidence import Evidence
from hydro_twin.inference.findings import Finding
from hydro_twin.inference.probability import (
    coarsened_posterior,
    min_null_probability,
    P_OTHER_LAW_CLEAN,
    P_OTHER_LAW_FAILS,
    P_OTHER_LAW_MISFIT,
    P_OTHER_LAW_NOISY,
    P_OTHER_LAW_STRUCTURED,
)
from hydro_twin.inference.screen import places, spans
from hydro_twin.inference.structure import is_drift_significant
from hydro_twin.plants import Plant, Port
from hydro_twin.result import AMBIGUOUS_DELTA_BIC, NamedEffect, VerdictKind

MIN_PREDICTED_SHARE = 0.01    # share of the residual that ports may predict if a law is right
P_STRUCTURE = 0.05      # p-value of that share
P_UNEXPLAINED = 0.01    # the same, where nothing is named and so nothing else is said
MAX_REMAINDER_SHARE = 0.1  # share of a misfit from which what is left is no detail of a right law
MIN_CERTAIN_ENERGY = 3000.0    # energy explained over the noise variance, to be sure of a law


def verdict_of(evidence: Evidence) -> VerdictKind:
    """Say what the evidence shows."""
    if evidence.findings:
        return 'effect_found'
    return 'unexplained' if is_structured(evidence, P_UNEXPLAINED) else 'nothing_missing'


def is_structured(evidence: Evidence, level: float) -> bool:
    """Whether what is left depends on anything, by tests at this level."""
    share, p_value = evidence.by_ports
    return bool(evidence.depends_on or evidence.lines or evidence.bursts
                or is_drift_significant(evidence.drifts)
                or evidence.is_larger_held_out or evidence.exceeds_any_noise
                or (p_value < level and share > MIN_PREDICTED_SHARE))


def is_residual_large(evidence: Evidence, explained: float) -> bool:
    """Whether the residual beside an effect is large, where it cannot be noise.

    Large relative to that of the linear model, or larger than what the effect explains: an effect
    that explains so little may only compensate for errors of other laws.

    Args:
        evidence: what the search ended with.
        explained: mean square that the effect explains, over that which is left.
    """
    before, after, noise = (error**2 for error in (
        evidence.before.error, evidence.after.error, evidence.floor))
    return after - noise > min(MAX_REMAINDER_SHARE * (before - noise), explained * after)


def named_effects(evidence: Evidence) -> tuple[NamedEffect, ...]:
    """Judge each finding against its rivals and against what is left."""
    if not evidence.findings:
        return ()
    reach = spans(evidence.after.candidate, evidence.fitted)
    held = conditional_on(evidence.after, evidence.fitted)
    return tuple(_judge(evidence, finding, reach, held) for finding in evidence.findings)


def _judge(evidence: Evidence, finding: Finding, reach: Mapping[Port, Span],
           held: Mapping[str, tuple[str, ...]]) -> NamedEffect:
    """Judge one finding.

    Args:
        evidence: what the search ended with.
        finding: the effect.
        reach: range of each port and signal.
        held: parameters of the plant that those of the effects depend on, see `conditional_on`.
    """
    placed = evidence.final.candidate.effects[finding.index]
    other_ports = tuple(rival.port.name for rival, distance in finding.rivals
                        if rival.effect.id == placed.effect.id and distance < AMBIGUOUS_DELTA_BIC)
    if placed.effect.course is not None:
        other_ports += tuple(name for combination in evidence.plant.combinations
                             if placed.port.name in combination for name in combination
                             if name not in (placed.port.name, *other_ports))
    alike = _alike(evidence.plant, placed.effect.id, (placed.port.name, *other_ports), reach)
    rivals = _by_id(finding, placed.effect.id, alike)
    samples = len(evidence.after.main.residual)
    explained = finding.share / (1.0 - min(finding.share, 1.0 - 1e-12))
    unknown = (_law_unknown(evidence, explained, samples) if finding.supported else
               P_OTHER_LAW_MISFIT)
    among = coarsened_posterior({placed.effect.id: 0.0, **dict(rivals)}, samples)
    return NamedEffect(
        finding.index, placed, finding.p_value, finding.share, unknown,
        probability=(1.0 - min_null_probability(finding.p_value)) * (1.0 - finding.doubt)
        * (1.0 - unknown) * among[placed.effect.id],
        ports=coarsened_posterior(_by_port(finding, placed, other_ports), samples),
        other_ports=other_ports, rivals=rivals,
        given={name: held[key] for name in placed.named
               if (key := f'{finding.index}:{name}') in held})


def _law_unknown(evidence: Evidence, explained: float, samples: int) -> float:
    """Return how often an effect was named in the place of a law outside the library.

    Args:
        evidence: what the search ended with.
        explained: mean square that the effect explains, over that which is left.
        samples: that were fitted.
    """
    if (explained * samples > MIN_CERTAIN_ENERGY and evidence.white
            and not is_structured(evidence, P_STRUCTURE)):
        return P_OTHER_LAW_CLEAN
    if evidence.exceeds_noise and is_residual_large(evidence, explained):
        return P_OTHER_LAW_MISFIT
    if evidence.is_larger_held_out:
        return P_OTHER_LAW_FAILS
    return (P_OTHER_LAW_NOISY if evidence.exceeds_noise or evidence.curve is not None else
            P_OTHER_LAW_STRUCTURED)


def _alike(plant: Plant, winner: str, ports: tuple[str, ...], reach: Mapping[Port, Span]
           ) -> list[str]:
    """List other effects that would look the same at these ports in this recording."""
    return [effect.id for effect, port in places(plant, ())
            if port.name in ports and effect.passes_for is not None
            and effect.passes_for(reach[port]) == winner]


def _by_port(finding: Finding, placed: Placed, alike: tuple[str, ...]) -> dict[str, float]:
    """Ports of an effect with their distance, its own first; those alike at no distance."""
    nearest = {placed.port.name: 0.0}
    for rival, distance in finding.rivals:
        if rival.effect.id == placed.effect.id:
            nearest.setdefault(rival.port.name, distance)
    for name in alike:
        nearest.setdefault(name, 0.0)
    return nearest


def _by_id(finding: Finding, winner: str, alike: list[str]) -> tuple[tuple[str, float], ...]:
    """Rivals of another name, each once, nearest first; those that look alike at no distance."""
    nearest = dict.fromkeys(alike, 0.0)
    for rival, distance in finding.rivals:
        if rival.effect.id != winner:
            nearest.setdefault(rival.effect.id, distance)
    return tuple(sorted(nearest.items(), key=lambda item: item[1]))
