"""The loop: fit, residual, effect, refit, until nothing more earns its place."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydro_twin.fitting.candidate import Candidate, Part, parts_of
from hydro_twin.fitting.free_run import Fit, fit_linear
from hydro_twin.model import Model
from hydro_twin.plants import Plant
from hydro_twin.predictors.scores import rms
from hydro_twin.recording.series import Recording
from hydro_twin.residual.chain import Finding, finely, FINEST, Ground, grow, without_last
from hydro_twin.residual.curve import find_curve, Found, is_better
from hydro_twin.residual.excerpt import excerpt
from hydro_twin.residual.noise import is_white, Line, lines, noise_floor
from hydro_twin.residual.proof import Improvement, improvement
from hydro_twin.residual.screen import Hidden, hidden
from hydro_twin.residual.select import contend, search, stretches
from hydro_twin.residual.structure import Dependence, dependences, drift, foretold

EVERY = 1000            # effects fitted in full in the first round
LIKELY = 0.05           # p-value from which something may be left that names do not explain
ENOUGH = 0.5            # least share of what is above the noise that effects must explain
TOLD = 0.01             # p-value from which what is left follows what happens at the ports


@dataclass(frozen=True)
class Trace:
    """What tracing found.

    Attributes:
        before, after: the fit at the start and at the end, on the training parts.
        train, test: the parts, in the order of the series.
        fitted: what of the training parts was fitted: all, or stretches of a long recording.
        hidden: effects that the recording could not have shown.
        proof: the improvement on the test parts, by what was named and by the curve.
        unseen: RMS of the residual of `after` on the test parts, but for their starts.
        floor: estimated RMS of the noise.
        depends_on: what the residual of `after` still depends on.
        drifts: (share, p-value) of a drift of the parameters in what is left.
        foretold: (share, p-value) of what is left that the signals at the ports foretell.
        found: a curve without a name, on top of `after`.
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
    unseen: float
    floor: float
    white: bool
    lines: tuple[Line, ...]
    depends_on: tuple[Dependence, ...]
    drifts: tuple[float, float]
    foretold: tuple[float, float]
    found: Found | None = None

    @property
    def final(self) -> Fit:
        """The model with all that was found, named or not."""
        return self.after if self.found is None else self.found.fit

    @property
    def changed(self) -> bool:
        """Whether anything was added to the model."""
        return bool(self.findings or self.found)


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
    contenders = contend(base, parts, EVERY, True, progress)
    if contenders:
        base = without_last(base, contenders[0].fit, parts)
    if model is None:
        before = base
    chain = grow(base, contenders, Ground(parts, unseen, seed, progress))
    findings = chain.findings
    after = base
    if findings:
        after = search(finely(chain.fit, parts, FINEST).candidate, parts, 60)
    if findings and explained_share(before, after) < ENOUGH and foretold(after, parts)[1] < TOLD:
        after, findings = before, ()        # what explains a part only is not what is missing
    progress('free curve')
    depends_on, found = dependences(after, parts), None
    if findings and (depends_on or foretold(after, parts)[1] < LIKELY):
        at_first = dependences(before, parts)
        alone = find_curve(before, parts, unseen, at_first, seed)
        if alone and is_better(alone, after, at_first):     # a law that has no name, but one place
            after, findings, depends_on, found = before, (), at_first, alone
    if found is None:
        found = find_curve(after, parts, unseen, depends_on, seed)
    pieces = stretches(after)
    final = after if found is None else found.fit
    return Trace(
        plant=plant, before=before, after=after, train=whole, test=unseen, fitted=parts,
        hidden=tuple(hidden(after, parts)), findings=findings,
        proof=improvement([before.candidate.residual(p) for p in unseen],
                          [final.candidate.residual(p) for p in unseen], seed),
        unseen=rms(np.concatenate([after.candidate.fitted_residual(p) for p in unseen])),
        floor=noise_floor(pieces), white=is_white(pieces),
        lines=tuple(lines(pieces, sample_time)),
        depends_on=tuple(depends_on), drifts=drift(after), foretold=foretold(after, parts),
        found=found)


def candidate_of(model: Model) -> Candidate:
    """Take the values of a model."""
    return Candidate(model.plant, model.values, model.sample_time, model.placed,
                     dict(model.timing), model.substeps)


def explained_share(before: Fit, after: Fit) -> float:
    """Share of the mean square error above the noise that a later fit takes off."""
    floor = noise_floor(stretches(after))
    return (before.error**2 - after.error**2) / max(before.error**2 - floor**2, 1e-300)
