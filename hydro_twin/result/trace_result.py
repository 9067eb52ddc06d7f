"""All that a trace found, and all that a report shows of it."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from hydro_twin.arrays import FloatArray
from hydro_twin.model import Estimate, Model
from hydro_twin.plants import Plant
from hydro_twin.recording.series import Series
from hydro_twin.result.effects import (
    BestNamed,
    FoundCurve,
    Improvement,
    NamedEffect,
    OverTime,
    Profile,
    Shape,
)
from hydro_twin.result.remainder import Remainder

# The test part: recordings of its own, the first third of every series, the second sixth of every
# series, every third series, or every third window.
TestPart = Literal['recordings', 'third', 'sixth', 'series', 'windows']
VerdictKind = Literal['effect_found', 'nothing_missing', 'unexplained']
Errors = Mapping[str, Mapping[str, float]]      # mode -> part -> RMS error, in the output's unit


@dataclass(frozen=True)
class Undetectable:
    """An effect that a recording could not have shown, and what would."""

    id: str
    port: str
    says: str


@dataclass(frozen=True)
class Memory:
    """What earlier recordings did to a model that was traced in a new one.

    Attributes:
        bags: the recordings that the model at the start came from.
        used: whether their say was kept: the error on the held-out part of the new recording is
            no larger for it.
        moved: parameters that the new recording has otherwise, beyond the errors of both.
        before, after: RMS error of the model at the start, and of the one that was traced, on
            held-out stretches of the earlier recordings; larger where the rig is another now.
    """

    bags: tuple[str, ...]
    used: bool
    moved: tuple[str, ...]
    before: float
    after: float


@dataclass(frozen=True)
class SeriesErrors:
    """The errors of the models before and after on one series, of the parts that it has."""

    bag: str
    before: Errors
    after: Errors


@dataclass(frozen=True)
class OutputErrors:
    """The errors of the free run on the output or a sensor, in its unit.

    Attributes:
        before, after: by part, 'train' and 'test', where it is measured there.
        noise: estimated RMS; of the output that of `TraceResult.noise`, of a sensor that of what
            the fit of the model after leaves of it.
    """

    unit: str
    before: Mapping[str, float]
    after: Mapping[str, float]
    noise: float


@dataclass(frozen=True)
class Run:
    """A series with the free runs of the models before and after, as their errors are reported.

    Attributes:
        label: 'test 1', 'training 2', ...
        measured, before, after: the output, (N,).
        first: index of the first sample that is scored.
    """

    label: str
    series: Series
    measured: FloatArray
    first: int
    before: FloatArray
    after: FloatArray


@dataclass(frozen=True)
class Factor:
    """What the data say of the parameters of a model, to be combined with other data.

    With d, what is added to the values of the model, |R d - step|^2 is twice the negative
    log-likelihood, up to a constant. What is no parameter, as the timing of the inputs, is
    eliminated.

    Attributes:
        names: (parameter of the plant or of an effect, index of the effect or None), p of them.
            The first parameter of a combination stands for all of it.
        R: (k, p), by the parameters in their units; rows for what is determined only.
        step: (k,).
    """

    names: tuple[tuple[str, int | None], ...]
    R: FloatArray
    step: FloatArray


@dataclass(frozen=True)
class TraceResult:
    """What a trace found.

    Attributes:
        nothing, law_unknown: probabilities that nothing is missing, and that a law is missing
            which is not known; what they leave of one is that of the effects named.
        evidence_left: what the port signals predict of the residual of the training part, each
            fifth of it by the others, as a gain of the log-likelihood [nats].
        tested: the test part.
        horizon: longest window [s] of the error over a horizon, where that judges: the plant
            integrates, or forgets its initial state so slowly that a free run says little else.
        before, after: the models without and with all that was found, with standard errors and
            with the errors that are reported.
        combinations: 'before' and 'after' -> of each of the plant's combinations the value and
            its standard error.
        factor: of the model after.
        effects: named, in the order in which they were added.
        shapes: of each of these, what it adds at its port; of linear dynamics, the error over
            their first parameter.
        curve: what no known effect explains, if a curve helps.
        best_named: the named effects that the curve took the place of, if it did.
        improvement: of what is judged on the test part, from before to after: the free run, or,
            where there is a horizon, the free runs over that.
        undetectable: effects that the recording could not have shown.
        outputs: the errors of the output and of each sensor that was fitted, by name.
        series: the errors by series, those left out where a run diverges.
        runs: of all series, those of the test part first.
        persistence: RMS error of repeating the last sample, on the test part.
        noise: estimated RMS of the noise.
        memory: of earlier recordings, if there are any.
        fails: whether the model does not fit, and nothing was found that would help.
        parts: how many stretches of the training and of the test part were long enough to run.
    """

    plant: Plant
    verdict: VerdictKind
    nothing: float
    law_unknown: float
    evidence_left: float
    tested: TestPart
    horizon: float | None
    before: Model
    after: Model
    combinations: Mapping[str, tuple[Estimate, ...]]
    factor: Factor
    effects: tuple[NamedEffect, ...]
    shapes: tuple[Shape | Profile | OverTime, ...]
    curve: FoundCurve | None
    best_named: BestNamed | None
    improvement: Improvement
    undetectable: tuple[Undetectable, ...]
    remainder: Remainder
    outputs: Mapping[str, OutputErrors]
    series: tuple[SeriesErrors, ...]
    runs: tuple[Run, ...]
    persistence: float
    noise: float
    memory: Memory | None
    fails: bool
    parts: tuple[int, int]

    @property
    def model(self) -> Model:
        """The model with all that was found."""
        return self.after

    @property
    def judged(self) -> str:
        """The error by which the models are judged: 'free_run', or 'horizon' if there is one."""
        return 'free_run' if self.horizon is None else 'horizon'

    @property
    def changed(self) -> bool:
        """Whether anything was added to the model."""
        return bool(self.effects) or self.curve is not None

    @property
    def ambiguous(self) -> tuple[tuple[str, ...], ...]:
        """Sets of ids that the data cannot tell apart."""
        return tuple((effect.id, *effect.close) for effect in self.effects if effect.close)
