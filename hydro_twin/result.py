"""The result of a trace as one finished value: what was found, and all that a report shows of it.

Nothing here fits or runs a model, and nothing is left to be computed from one.
"""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from hydro_twin.arrays import FloatArray
from hydro_twin.effects import Placed
from hydro_twin.model import Estimate, Model
from hydro_twin.plants import Plant, Port
from hydro_twin.recording.series import Series

CLOSE = 10.0            # difference in BIC below which the data do not decide between two laws
NEAR = 100.0            # difference in BIC up to which a rival is near
CERTAIN = 0.99          # probability from which a law is certain
# The test part: the first third of every series, or the second sixth, or every third series.
THIRD, SIXTH, SERIES = 3, 6, 1

VerdictKind = Literal['effect_found', 'nothing_missing', 'unexplained']
Errors = Mapping[str, Mapping[str, float]]      # mode -> part -> RMS error, in the output's unit


@dataclass(frozen=True)
class Improvement:
    """How much smaller a mean square error became.

    Attributes:
        relative: 1 - after / before.
        low, high: its bootstrap interval at 98 %.
    """

    relative: float
    low: float
    high: float


@dataclass(frozen=True)
class FreeCurve:
    """A free curve over a signal: knots, what is added there, its standard error, each (K,)."""

    label: str
    knots: FloatArray
    added: FloatArray
    std_error: FloatArray


@dataclass(frozen=True)
class Shape:
    """What an effect adds at its port, as it acts in the run and as free curves have it.

    Attributes:
        signal: that is shown over, a signal at the port or 'value'.
        reads: how many signals the law depends on.
        x, added: some samples of the signal and of what the law adds, (N,).
        curves: fitted without the law; one, or one for a rising and one for a falling signal.
    """

    signal: str
    reads: int
    x: FloatArray
    added: FloatArray
    curves: tuple[FreeCurve, ...]


@dataclass(frozen=True)
class Profile:
    """The output error over the first parameter of an effect, all else as fitted.

    Attributes:
        values, errors: (K,), RMS on what was fitted.
        error: at the value that was fitted.
    """

    values: FloatArray
    errors: FloatArray
    error: float


@dataclass(frozen=True)
class OverTime:
    """How a parameter of the plant went over time.

    Attributes:
        time: [s] from the start of the recording, (K,).
        values: of the parameter by its law, (K,).
        free: of the parameter as the recording shows them at some times, without any law.
    """

    time: FloatArray
    values: FloatArray
    free: FreeCurve


@dataclass(frozen=True)
class NamedEffect:
    """An effect that the plant lacks.

    Attributes:
        index: of the effect among those of the model after.
        placed: the effect with its values.
        p_value: of what it adds to the others, for all that was tried.
        share: of the mean square error without it that it takes off.
        law_unknown: probability that the law is none of the library's.
        probability: that this is the law; where it sits may still be open.
        ports: probability of each port at which it may sit, given the effect; its own first.
        other_ports: where it would explain as much.
        rivals: (id, difference in BIC) of other effects in its place, nearest first.
        given: parameter of the effect -> parameters of the plant that the recording does not
            determine: the value holds only for these as they stand.
    """

    index: int
    placed: Placed
    p_value: float
    share: float
    law_unknown: float
    probability: float
    ports: Mapping[str, float]
    other_ports: tuple[str, ...]
    rivals: tuple[tuple[str, float], ...]
    given: Mapping[str, tuple[str, ...]]

    @property
    def id(self) -> str:
        """Its id."""
        return self.placed.effect.id

    @property
    def port(self) -> str:
        """The name of its port."""
        return self.placed.port.name

    @property
    def certain(self) -> bool:
        """Whether the data single out this law."""
        return self.probability >= CERTAIN

    @property
    def close(self) -> tuple[str, ...]:
        """The ids of the rivals between which and it the data do not decide."""
        return tuple(name for name, distance in self.rivals if distance < CLOSE)


@dataclass(frozen=True)
class FoundCurve:
    """A curve without a name: the last effect of the model after.

    Attributes:
        improvement: of the mean square error on held-out data, against the model without it.
        p_value: of what it adds, for all that was tried.
        others: (curve at another place, difference in BIC), nearest first.
    """

    placed: Placed
    improvement: Improvement
    p_value: float
    others: tuple[tuple[Placed, float], ...]


@dataclass(frozen=True)
class BestNamed:
    """The best explanation by named effects, where a free curve took their place.

    Attributes:
        effects: with their values.
        held_out_error: RMS of what they leave of the test part, but for its initial states.
    """

    effects: tuple[Placed, ...]
    held_out_error: float


@dataclass(frozen=True)
class Dependence:
    """What a free curve at one port over one signal explains of a residual.

    Attributes:
        signal: 'value' of the port, or a signal there.
        share: of the residual's power, by cross-validation over blocks of the training part.
        p_value: of the share under noise, for all dependences tried.
        knots, curve: the signal and what is added to the value of the port there.
    """

    port: Port
    signal: str
    share: float
    p_value: float
    knots: FloatArray
    curve: FloatArray


@dataclass(frozen=True)
class Line:
    """A spectral line: frequency [Hz], amplitude in the unit of the residual."""

    frequency: float
    amplitude: float


@dataclass(frozen=True)
class Spell:
    """When much of a residual comes, in seconds from the start of its bag."""

    bag: str
    begin: float
    end: float


@dataclass(frozen=True)
class Hidden:
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
class Remainder:
    """The residual of the plant with all named effects.

    Attributes:
        error: RMS of what was fitted, in the output's unit.
        held_out_error: the same of the test part.
        white: by the test of Ljung and Box.
        spells: when much of it comes, if seldom, by bag and time.
        depends_on: port signals that explain some of it, the strongest first.
        drifts: whether the parameters drift over the recording.
        by_ports: (share, p-value) of what the port signals predict of it, in any way.
        loud: whether it is larger than noise can be.
        larger_held_out: whether it is larger on held-out data than by chance.
        structured: whether any test finds structure in it.
    """

    error: float
    held_out_error: float
    white: bool
    lines: tuple[Line, ...]
    spells: tuple[Spell, ...]
    depends_on: tuple[Dependence, ...]
    drifts: bool
    by_ports: tuple[float, float]
    loud: bool
    larger_held_out: bool
    structured: bool


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
        tested: the test part: the first third (3) of every series, its second sixth (6), every
            third series (1), or recordings of its own (0).
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
        found: what no known effect explains, if a curve helps.
        best_named: the named effects that the curve took the place of, if it did.
        improvement: of what is judged on the test part, from before to after: the free run, or,
            where there is a horizon, the free runs over that.
        hidden: effects that the recording could not have shown.
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
    tested: int
    horizon: float | None
    before: Model
    after: Model
    combinations: Mapping[str, tuple[Estimate, ...]]
    factor: Factor
    effects: tuple[NamedEffect, ...]
    shapes: tuple[Shape | Profile | OverTime, ...]
    found: FoundCurve | None
    best_named: BestNamed | None
    improvement: Improvement
    hidden: tuple[Hidden, ...]
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
        return bool(self.effects) or self.found is not None

    @property
    def ambiguous(self) -> tuple[tuple[str, ...], ...]:
        """Sets of ids that the data cannot tell apart."""
        return tuple((effect.id, *effect.close) for effect in self.effects if effect.close)
