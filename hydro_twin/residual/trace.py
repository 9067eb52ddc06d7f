"""The loop: fit, residual, effect, refit, until nothing more earns its place."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydro_twin.fitting.candidate import Candidate, Part, parts_of, rms
from hydro_twin.fitting.free_run import Fit, fit_linear
from hydro_twin.model import Model
from hydro_twin.plants import Plant
from hydro_twin.recording.series import Recording
from hydro_twin.residual.excerpt import excerpt
from hydro_twin.residual.noise import is_white, Line, lines, noise_floor
from hydro_twin.residual.proof import Improvement, improvement
from hydro_twin.residual.screen import Hidden, hidden
from hydro_twin.residual.select import (
    CLEARLY,
    contend,
    Contender,
    criterion,
    gain_p_value,
    search,
    stretches,
)
from hydro_twin.residual.structure import Dependence, dependences, drift, foretold

MOST = 4                # effects in a model
LEVEL = 1e-3            # of a test, corrected for all that was tried
WORTH = 0.01            # least share of the mean square error that an effect must take off
FINE = 0.2              # largest error of the time stepping, as a share of the residual
FINEST = 16             # steps in a sample
EVERY, LATER = 1000, 8  # effects fitted in full in the first round and later
ENOUGH = 0.5            # least share of what is above the noise that effects must explain
TOLD = 0.01             # p-value from which what is left follows what happens at the ports
TRIED = 40              # starts tried in a round, for the correction


@dataclass(frozen=True)
class Finding:
    """One effect that earned its place.

    Attributes:
        index: of the effect in the final candidate.
        p_value: of what it adds, for all that was tried.
        share: of the mean square error, as it was then, that it took off.
        evidence: rise of the log-likelihood ratio, twice.
        rivals: (contender, distance of the criterion) of the other effects, best first.
    """

    index: int
    p_value: float
    share: float
    evidence: float
    rivals: tuple[tuple[Contender, float], ...]


@dataclass(frozen=True)
class Trace:
    """What tracing found.

    Attributes:
        before, after: the fit at the start and at the end, on the training parts.
        train, test: the parts, in the order of the series.
        fitted: what of the training parts was fitted: all, or stretches of a long recording.
        hidden: effects that the recording could not have shown.
        proof: the improvement on the test parts.
        floor: estimated RMS of the noise.
        depends_on: what the residual at the end still depends on.
        drifts: (share, p-value) of a drift of the parameters in what is left.
        foretold: (share, p-value) of what is left that the signals at the ports foretell.
    """

    plant: Plant
    before: Fit
    after: Fit
    train: Sequence[Part]
    test: Sequence[Part]
    fitted: Sequence[Part]
    hidden: tuple[Hidden, ...]
    findings: tuple[Finding, ...]
    proof: Improvement
    floor: float
    white: bool
    lines: tuple[Line, ...]
    depends_on: tuple[Dependence, ...]
    drifts: tuple[float, float]
    foretold: tuple[float, float]


def trace(train: Recording, test: Recording, plant: Plant,
          constants: Mapping[str, float] | None = None, model: Model | None = None,
          seed: int = 0, progress: Callable[[str], None] = lambda _: None) -> Trace:
    """Find what a plant's linear model lacks of a recording.

    Args:
        train: what is fitted.
        test: what is not, and judges.
        plant: the plant.
        constants: of the rig, where they differ from the plant's defaults.
        model: where to start, instead of a fresh fit of the linear plant.
        seed: of the random starts and of the bootstrap.
        progress: told what is being done.

    Raises:
        DataError: a recording is too short, constant or not finite.
    """
    whole, unseen = parts_of(train, plant), parts_of(test, plant)
    parts = excerpt(whole)
    sample_time = train.series[0].sample_time
    progress('linear model')
    if model is None:
        before = fit_linear(plant, parts, plant.constant_values(constants), sample_time,
                            'physical', timing=True, seed=seed)
    else:
        before = search(candidate_of(model), parts, 1)
    base = before if model is None else search(before.candidate, parts, 40)
    findings: list[Finding] = []
    while len(findings) < MOST:
        contenders = contend(base, parts, LATER if findings else EVERY, not findings, progress)
        if not contenders:
            break
        base = without_last(base, contenders[0].fit, parts)
        if model is None and not findings:
            before = base
        if not earns(base, contenders[0].fit, unseen, seed):
            break
        found = finding(base, contenders, len(base.candidate.effects))
        if findings and nearest(found, contenders[0].id) < CLEARLY:
            break                           # what one law leaves is no evidence for just any other
        findings.append(found)
        base = finely(contenders[0].fit, parts)
        base, findings = prune(base, findings, parts)
    after = search(base.candidate, parts, 60) if findings else base
    if findings and explained_share(before, after) < ENOUGH and foretold(after, parts)[1] < TOLD:
        after, findings = before, []        # what explains a part only is not what is missing
    pieces = stretches(after)
    return Trace(
        plant=plant, before=before, after=after, train=whole, test=unseen, fitted=parts,
        hidden=tuple(hidden(after, parts)), findings=tuple(findings),
        proof=improvement([before.candidate.residual(p) for p in unseen],
                          [after.candidate.residual(p) for p in unseen], seed),
        floor=noise_floor(pieces), white=is_white(pieces),
        lines=tuple(lines(pieces, sample_time)),
        depends_on=tuple(dependences(after, parts)),
        drifts=drift(after), foretold=foretold(after, parts))


def candidate_of(model: Model) -> Candidate:
    """Take the values of a model."""
    return Candidate(model.plant, model.values, model.sample_time, model.placed,
                     dict(model.timing), model.substeps)


def explained_share(before: Fit, after: Fit) -> float:
    """Share of the mean square error above the noise that a later fit takes off."""
    floor = noise_floor(stretches(after))
    return (before.error**2 - after.error**2) / max(before.error**2 - floor**2, 1e-300)


def without_last(base: Fit, better: Fit, parts: Sequence[Part]) -> Fit:
    """Search the base once more from where an effect has led; the better of the two.

    What a longer search alone gains must not be credited to the effect.
    """
    candidate = replace(better.candidate, effects=better.candidate.effects[:-1])
    return min(base, search(candidate, parts, 40), key=lambda fit: fit.cost)


def earns(before: Fit, after: Fit, unseen: Sequence[Part], seed: int) -> bool:
    """Whether an effect earns its place: likely, worth it, and so on data it did not fit."""
    if gain_p_value(before, after, TRIED) > LEVEL:
        return False
    if 1.0 - (after.error / before.error) ** 2 < WORTH:
        return False
    on_unseen = improvement([before.candidate.residual(p) for p in unseen],
                            [after.candidate.residual(p) for p in unseen], seed)
    return on_unseen.low > 0.0


def finding(before: Fit, contenders: Sequence[Contender], index: int) -> Finding:
    """Describe the best contender against the base and against the others."""
    best, *others = contenders
    scores = criterion([c.fit for c in contenders])
    none, one = criterion([before, best.fit])
    return Finding(
        index=index, p_value=gain_p_value(before, best.fit, TRIED),
        share=1.0 - (best.fit.error / before.error) ** 2, evidence=none - one,
        rivals=tuple((c, score - scores[0]) for c, score in
                     zip(others, scores[1:], strict=True)))


def nearest(found: Finding, winner: str) -> float:
    """Distance of the criterion to the nearest effect of another name."""
    return min((d for contender, d in found.rivals if contender.id != winner), default=np.inf)


def finely(fit: Fit, parts: Sequence[Part]) -> Fit:
    """Shorten the steps until halving them changes the output little, then fit again."""
    candidate = fit.candidate
    while candidate.substeps < FINEST:
        finer = replace(candidate, substeps=2 * candidate.substeps)
        starts = [(part.inputs, candidate.start(part)) for part in parts]
        change = rms(np.concatenate([finer.system.run(*start) - candidate.system.run(*start)
                                     for start in starts]))
        if change < FINE * fit.error:
            break
        candidate = finer
    return fit if candidate is fit.candidate else search(candidate, parts, 40)


def prune(fit: Fit, findings: list[Finding], parts: Sequence[Part]
          ) -> tuple[Fit, list[Finding]]:
    """Drop the effects found earlier that a later one has made needless."""
    last = len(fit.candidate.effects) - 1
    for found in findings[:-1]:
        effects = list(fit.candidate.effects)
        del effects[found.index]
        without = search(replace(fit.candidate, effects=tuple(effects)), parts, 40)
        scores = criterion([fit, without])
        if scores[1] < scores[0] + CLEARLY:
            kept = [replace(f, index=f.index - (f.index > found.index)) for f in findings
                    if f is not found]
            return prune(without, kept, parts) if last > 1 else (without, kept)
    return fit, findings
