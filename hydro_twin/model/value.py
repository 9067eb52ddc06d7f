"""A model as one value: its structure, its numbers, and apart from them what is known of it."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
import math
from pathlib import Path
from typing import Any

from hydro_twin.arrays import FloatArray
from hydro_twin.effects import Placed
from hydro_twin.errors import ModelError
from hydro_twin.plants import Plant
from hydro_twin.predictors import kind_named, make_predictor, modes_of, Predictor
from hydro_twin.predictors.system import assemble, HOLD, System
from hydro_twin.recording.clock import same
from hydro_twin.recording.series import Series

MOST_SUBSTEPS = 1024            # in a sample: 2 us at 500 Hz, which no effect needs


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """How well data determine a parameter.

    Attributes:
        std_error: standard error in the parameter's unit; None where it is not known.
        identifiable: whether the data determine it at all (by itself, not only in a combination).
        at_bound: 'lower' or 'upper', the edge of the search box at which the fit stopped; or ''.
        held: whether it was taken as known, and not fitted.
    """

    std_error: float | None = None
    identifiable: bool = True
    at_bound: str = ''
    held: bool = False


@dataclass(frozen=True)
class Estimate(Uncertainty):
    """The value of a parameter, with its uncertainty."""

    value: float


@dataclass(frozen=True)
class Noise:
    """What the observer takes as known of noise, by maximum likelihood, and of slow change.

    Attributes:
        measurement: standard deviation of the measured output, in its unit.
        process: intensity of white noise on the rates of states, by name, in the state's SI unit
            over the root of a second; zero where there is none.
        start: standard deviation of each state at the start of a run, by name, in its SI unit.
        follow: the parameters that the observer follows, with the relative change of each over
            the root of a second; those of effects as 'ID@PORT:NAME'. Stated, not estimated.
        sensors: standard deviation of the noise of each sensor that is used, by name, in its unit.
        innovation: RMS of the standard deviation that the observer expects of its innovation with
            the sensors of the recording that it was fitted to; None where there were none.
    """

    measurement: float
    process: Mapping[str, float]
    start: Mapping[str, float]
    follow: Mapping[str, float] = field(default_factory=dict)
    sensors: Mapping[str, float] = field(default_factory=dict)
    innovation: float | None = None


@dataclass(frozen=True)
class Record:
    """What is known of a model: no run depends on it.

    Attributes:
        uncertainty: of parameters by name, and of those of effects as 'INDEX:NAME'.
        errors: {'before' and 'after': {'one_step', 'free_run' and, with noise, 'observer':
            {'train', 'test'}}}, in the unit of the output.
        provenance: bags with their SHA-256, command, seed, version.
        notes: what a reader of the values must know, a sentence each.
    """

    uncertainty: Mapping[str, Uncertainty] = field(default_factory=dict)
    errors: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def reference_rms(self, mode: str) -> float | None:
        """RMS error that the model had on data it did not fit; None where it does not say."""
        after = self.errors.get('after', {}).get(mode, {})
        value = after.get('test', after.get('train'))
        return float(value) if value is not None and math.isfinite(value) else None

    def std_error(self, index: int, name: str) -> float | None:
        """Return the standard error of a parameter of the effect of that index, if it is known."""
        return self.uncertainty.get(f'{index}:{name}', Uncertainty()).std_error


@dataclass(frozen=True)
class Model:
    """A plant with effects at its ports, and values for everything that a run needs.

    Attributes:
        values: parameters and constants by name.
        effects: at ports of the plant, with their parameters.
        timing: how late each input acts [s], by name: what the stamps cannot tell (see docs).
        interpolation: of commands between samples: 'hold' or 'linear'.
        substeps: integration steps in a sample, chosen by error when the model was fitted.
        kind: name of the predictor that runs it.
        noise: for the observer; None: it cannot run.
        network: name of the weights file beside the model file.
        record: what is known of it besides.
    """

    plant: Plant
    values: Mapping[str, float]
    sample_time: float
    effects: tuple[Placed, ...] = ()
    timing: Mapping[str, float] = field(default_factory=dict)
    interpolation: str = HOLD
    substeps: int = 4
    kind: str = 'analytical'
    noise: Noise | None = None
    network: str | None = None
    record: Record = field(default_factory=Record)

    @property
    def constants(self) -> dict[str, float]:
        """The plant's constants by name."""
        return {c.name: self.values[c.name] for c in self.plant.constants}

    @property
    def parameters(self) -> dict[str, Estimate]:
        """The plant's parameters by name, none of a model without physics."""
        known, names = self.record.uncertainty, {p.name for p in self.plant.parameters}
        return {name: Estimate(value, **vars(known.get(name, Uncertainty())))
                for name, value in self.values.items() if name in names}

    @property
    def errors(self) -> Mapping[str, Any]:
        """The errors of its fit, see `Record`."""
        return self.record.errors

    @cached_property
    def system(self) -> System:
        """What the kernel runs."""
        return assemble(self.plant, self.values, self.effects, self.sample_time, self.substeps,
                        self.timing, self.interpolation)

    @property
    def start_up(self) -> int:
        """How many samples at the start of a series set its state, and are not scored."""
        return self.plant.start_samples(self.sample_time)

    def without(self, index: int) -> Model:
        """Take one of the effects out; a negative index counts from the last."""
        kept = list(self.effects)
        del kept[index]
        return replace(self, effects=tuple(kept))

    def with_record(self, **changes: Any) -> Model:
        """Change entries of the record, by their names."""
        return replace(self, record=replace(self.record, **changes))

    def at(self, sample_time: float) -> Model:
        """Return the same physics at another sample time [s].

        The laws are integrated with steps no longer than before (but at most `MOST_SUBSTEPS` in a
        sample), and eq. 1 is that of the new sample time. The errors are those at the old one.

        Raises:
            ModelError: the sample time is not a positive number, or the model has a network, which
                knows its own sample time only.
        """
        if not 0.0 < sample_time < math.inf:
            raise ModelError(f'a sample time of {sample_time:g} s must be above 0, and finite')
        if same(sample_time, self.sample_time):
            return self
        if kind_named(self.kind).weights:
            raise ModelError(f'a model of kind {self.kind} runs at {self.sample_time:g} s only, '
                             f'not at {sample_time:g} s')
        steps = math.ceil(self.substeps * sample_time / self.sample_time - 1e-9)
        timing = {name: max(late, -sample_time) for name, late in self.timing.items()}
        return replace(self, sample_time=sample_time, substeps=min(steps, MOST_SUBSTEPS),
                       timing=timing)

    def predictor(self, folder: Path = Path()) -> Predictor:
        """Make what runs the model; its weights, if it has any, lie in the folder.

        Raises:
            ModelError: they are missing, or do not fit.
        """
        return make_predictor(self, folder)

    def run(self, series: Series, mode: str = 'free_run', folder: Path = Path()) -> FloatArray:
        """Predict the output of every sample of a series.

        Args:
            series: at the sample time of the model.
            mode: 'one_step', 'free_run' or 'observer'.
            folder: where its weights lie, if it has any.

        Returns:
            Shape (N,), in the output's unit; nan where there is none.

        Raises:
            ModelError: its weights are missing, the series is of another sample time, or the model
                does not run in that mode.
        """
        if mode not in modes_of(self):
            raise ModelError(f'mode {mode}: this model has {", ".join(modes_of(self))}')
        if not same(series.sample_time, self.sample_time):
            raise ModelError(f'a series of {series.sample_time:g} s; the model runs at '
                             f'{self.sample_time:g} s (see Model.at)')
        prediction: FloatArray = getattr(self.predictor(folder), mode)(series)
        return prediction
