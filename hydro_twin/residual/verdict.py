"""The verdict: what may be said of a trace, and how certainly."""
from __future__ import annotations

from dataclasses import dataclass

from hydro_twin.residual.chain import Finding, NEAR
from hydro_twin.residual.screen import places, spans
from hydro_twin.residual.structure import drifts
from hydro_twin.residual.trace import Trace

CLOSE = 10.0            # distance of the criterion below which the data do not tell rivals apart
LEFT = 0.01             # share of what is left, foretold by the ports, that makes a law wrong
LIKELY = 0.05           # p-value of that, or any below 1 where what is left has memory
CLEAN = 2.5             # error over that of the noise, up to which it may be coloured noise alone
TELLING = 3000.0        # power explained over the noise's, to tell a law from one a little off


@dataclass(frozen=True)
class Judged:
    """A finding with what may be said of it.

    Attributes:
        certain: of the law; where it sits may still be open.
        elsewhere: other ports where it would explain as much.
        rivals: (id, distance of the criterion) of other effects, nearest first.
    """

    finding: Finding
    id: str
    port: str
    certain: bool
    elsewhere: tuple[str, ...]
    rivals: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Verdict:
    """What may be said.

    Attributes:
        kind: 'effect_found', 'nothing_missing' or 'unexplained'.
        ambiguous: sets of ids that the data cannot tell apart.
    """

    kind: str
    judged: tuple[Judged, ...]
    ambiguous: tuple[tuple[str, ...], ...]


def judge(trace: Trace) -> Verdict:
    """Say what a trace shows."""
    judged = tuple(_judge(trace, finding) for finding in trace.findings)
    ambiguous = tuple(
        (j.id, *[name for name, distance in j.rivals if distance < CLOSE])
        for j in judged if any(distance < CLOSE for _, distance in j.rivals))
    structured = is_structured(trace, 0.2 * LIKELY)
    if judged:
        return Verdict('effect_found', judged, ambiguous)
    return Verdict('unexplained' if structured else 'nothing_missing', (), ())


def is_structured(trace: Trace, level: float) -> bool:
    """Whether what is left depends on anything, by tests at this level."""
    share, p_value = trace.foretold
    return bool(trace.depends_on or trace.lines or trace.bursts or drifts(trace.drifts)
                or trace.is_stranger or trace.is_loud or (p_value < level and share > LEFT))


def _judge(trace: Trace, finding: Finding) -> Judged:
    """Judge one finding against its rivals and against what is left."""
    placed = trace.after.candidate.effects[finding.index]
    elsewhere = tuple(contender.placed.port.name for contender, distance in finding.rivals
                      if contender.id == placed.effect.id and distance < CLOSE)
    alike = _alike(trace, placed.effect.id, (placed.port.name, *elsewhere))
    rivals = _by_id(finding, placed.effect.id, alike)
    telling = finding.share / (1.0 - min(finding.share, 1.0 - 1e-12)) * len(trace.after.residual)
    return Judged(
        finding, placed.effect.id, placed.port.name,
        certain=telling > TELLING and not is_structured(trace, LIKELY if trace.white else 1.0)
        and trace.after.error < CLEAN * trace.floor
        and all(distance > NEAR for _, distance in rivals),
        elsewhere=elsewhere, rivals=rivals)


def _alike(trace: Trace, winner: str, ports: tuple[str, ...]) -> list[str]:
    """List other effects that would look the same at these ports in this recording."""
    candidate = trace.after.candidate
    reach = spans(candidate, trace.fitted)
    return [effect.id for effect, port in places(candidate.plant, ())
            if port.name in ports and effect.passes_for is not None
            and effect.passes_for(reach[port]) == winner]


def _by_id(finding: Finding, winner: str, alike: list[str]) -> tuple[tuple[str, float], ...]:
    """Rivals of another name, each once, nearest first; those that look alike at no distance."""
    nearest = dict.fromkeys(alike, 0.0)
    for contender, distance in finding.rivals:
        if contender.id != winner:
            nearest.setdefault(contender.id, distance)
    return tuple(sorted(nearest.items(), key=lambda item: item[1]))
