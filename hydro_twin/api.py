"""The Python interface, on which the commands are thin layers: `import hydro_twin as ht`."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.arrays import FloatArray
from hydro_twin.blas import one_thread
from hydro_twin.errors import UserError
from hydro_twin.fitting import refit as fitting
from hydro_twin.fitting.horizon import horizon_errors
from hydro_twin.fitting.refit import Refit, Request
from hydro_twin.model import load_predictor, Model, read_model
from hydro_twin.parallel import prepare
from hydro_twin.plants import Plant, plant_named
from hydro_twin.predictors import kind_named, MODES, OBSERVER, Predictor
from hydro_twin.predictors.analytical import Analytical, deviations
from hydro_twin.predictors.scores import (
    fit_percent,
    persistence,
    pooled,
    predict,
    rms,
    runs_over,
    sensor_errors,
)
from hydro_twin.progress import Progress, silent
from hydro_twin.provenance import provenance
from hydro_twin.recording.rig import read_apart, Rig, rig_of
from hydro_twin.recording.series import Recording, split
from hydro_twin.result import TraceResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hydro_twin.inference.excitation import Excitation

__all__ = ['Data', 'Model', 'Predictor', 'Recording', 'Refit', 'Replay', 'Request', 'Trace',
           'excitation', 'load_predictor', 'read', 'read_model', 'refit', 'replay', 'trace']

Paths = Path | str | Sequence[Path | str]


@dataclass(frozen=True)
class Data:
    """Bags as read, with what is known of the rig.

    Attributes:
        rig: the plant, its constants in SI units, its signals.
        recording: the series of the bags, on one time grid, in SI units.
        test: those of the bags to test on; None if there are none.
        earlier: those that a model to start from came from; None if none are used.
    """

    rig: Rig
    recording: Recording
    test: Recording | None = None
    earlier: Recording | None = None

    @property
    def plant(self) -> Plant:
        """The plant."""
        return self.rig.plant

    @property
    def parts(self) -> tuple[Recording, Recording]:
        """(train, test); without bags to test on, the first third of every series tests [B19]."""
        return split(self.recording) if self.test is None else (self.recording, self.test)

    def provenance(self, seed: int, command: str) -> dict[str, Any]:
        """Say where a model comes from that is made of this."""
        return provenance(self.recording.sources, self.test.sources if self.test else (), seed,
                          command)


@dataclass(frozen=True)
class Replay:
    """A model run over a recording.

    Attributes:
        recording: what was recorded.
        predictions: 'one_step', 'free_run' and, where the model knows its noise, 'observer' -> for
            each series an array of its length, in the output's unit; nan where there is no
            prediction, or it has diverged.
        horizon: RMS error over a horizon, of an analytical model whose plant integrates.
        sensors: of each sensor that was recorded, of an analytical model, (measured - free run,
            measured) where it is there, in its unit.
        states: of an analytical model that knows its noise, see `deviations`.
    """

    plant: Plant
    recording: Recording
    predictions: Mapping[str, Sequence[FloatArray]]
    horizon: float | None = None
    sensors: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    states: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Return samples and errors, as `replay --json` prints them.

        In the output's unit, under `outputs` of each sensor in its own.
        """
        result: dict[str, Any] = {
            'samples': sum(map(len, self.recording.series)),
            'series': len(self.recording.series),
            'sample_time': self.recording.sample_time,
            'unit': self.plant.output.unit,
        }
        for mode, predicted in self.predictions.items():
            error, measured = pooled(self.recording, self.plant, predicted, mode)
            result[mode] = {'rmse': rms(error), 'fit_percent': fit_percent(error, measured)}
        if self.horizon is not None:
            result['horizon'] = {'rmse': self.horizon}
        units = {sensor.name: sensor.unit for sensor in self.plant.sensors}
        outputs = {self.plant.output.name: {
            'unit': self.plant.output.unit, 'samples': result['samples'],
            'free_run': result['free_run']}} | {name: {
                'unit': units[name], 'samples': len(error),
                'free_run': {'rmse': rms(error), 'fit_percent': fit_percent(error, measured)}}
                for name, (error, measured) in self.sensors.items()}
        result |= {'outputs': outputs,
                   'persistence': {'rmse': persistence(self.recording, self.plant)}}
        return {**result, 'states': self.states} if self.states else result

    def figure(self, name: str = 'model') -> Figure:
        """Draw how the recording begins, measured and by free run, and the errors."""
        from hydro_twin.report.picture import draw

        return draw(self.recording, self.plant, {name: self.predictions['free_run']},
                    {name: self.summary()['free_run']['rmse']})


@dataclass(frozen=True)
class Trace:
    """What a trace found, and where it comes from.

    Attributes:
        result: all that was found, computed once.
        provenance: for the model files.
    """

    result: TraceResult
    provenance: Mapping[str, Any]

    @property
    def model(self) -> Model:
        """The model with all that was found."""
        return self.result.after.with_record(provenance=self.provenance)

    @property
    def before(self) -> Model:
        """The model without it."""
        return self.result.before.with_record(provenance=self.provenance)

    def summary(self) -> dict[str, Any]:
        """Return what report.json holds; errors in the output's unit."""
        from hydro_twin.report.summary import summarise

        return summarise(self.result)

    def figures(self) -> dict[str, Figure]:
        """Draw the figures of the report, by the names of their files."""
        from hydro_twin.report.drawing import draw
        from hydro_twin.report.figures import illustrations

        return {one.name: draw(one) for one in illustrations(self.result)}

    def save(self, folder: Path | str) -> dict[str, Any]:
        """Write report, models and figures into a folder; returns what report.json holds.

        Raises:
            UserError: the folder cannot be written.
        """
        from hydro_twin.report.trace_files import write_files

        return write_files(self.result, Path(folder), dict(self.provenance))


def read(bags: Paths, plant: Plant | str, *, test: Paths = (), earlier: Paths = (),
         config: Path | str | None = None, constants: Mapping[str, float] | None = None,
         model: Model | None = None, show: Progress = silent) -> Data:
    """Read bags of a plant.

    Args:
        bags: rosbag2 recordings: folders, or single files.
        plant: the plant, or its name.
        test: bags to test on; none: the first third of every series.
        earlier: bags that a model to start from came from, of which a trace is to keep what they
            say.
        config: ROS parameter file with signals and constants; None: that of the plant.
        constants: of the rig, in SI units; they take precedence over the file.
        model: whose sample time is the usual one.
        show: shows what is being done.

    Raises:
        UserError: there is no such plant, no bag is given, or the configuration or a constant is
            wrong.
        BagError: a bag cannot be read, or lacks a signal.
    """
    if not _paths(bags):
        raise UserError('no bags are given')
    plant = plant_named(plant) if isinstance(plant, str) else plant
    rig = rig_of(plant, Path(config) if config else None, dict(constants or {}), model)
    return read_data(_paths(bags), _paths(test), rig, show, _paths(earlier))


def read_data(bags: Sequence[Path], test: Sequence[Path], rig: Rig, show: Progress = silent,
              earlier: Sequence[Path] = ()) -> Data:
    """Read bags of a rig, those to test on and earlier ones, all on one clock.

    Raises:
        BagError: a bag cannot be read, or lacks a signal.
    """
    recording, *others = read_apart([bags, *filter(None, (test, earlier))], rig, show)
    return Data(rig, recording, others.pop(0) if test else None,
                others.pop() if earlier else None)


def refit(data: Data, request: Request | None = None, *, command: str = 'hydro_twin.refit',
          show: Progress = silent) -> Refit:
    """Fit a model.

    Args:
        data: what to fit it to.
        request: what to fit and how; None: an analytical model by least squares.
        command: what the model file is to say that it was made by.
        show: shows what is being done.

    Raises:
        UserError: what is asked for does not go together.
        DataError: the samples do not allow it.
        ModuleNotFoundError: torch is needed and not installed.
    """
    request = request or Request()
    return fitting.refit(*data.parts, data.plant, data.rig.constants, request,
                         data.provenance(request.seed, command), show)


def trace(data: Data, model: Model | None = None, seed: int = 0, *,
          command: str = 'hydro_twin.trace', show: Progress = silent) -> Trace:
    """Find the effects that a model lacks.

    Args:
        data: what it is to explain.
        model: an analytical one to start from; None: a fresh fit.
        seed: of the random numbers.
        command: what the model file is to say that it was made by.
        show: shows what is being done.

    Raises:
        UserError: the model is not an analytical one, or of another plant than the data.
        DataError: the samples do not allow it.
    """
    model = None if model is None else _analytical(model, data)
    prepare('hydro_twin.inference.trace', 'hydro_twin.report.drawing')

    from hydro_twin.inference import trace as tracing

    with show('tracing', None) as step:
        result = tracing.trace(data.recording, data.test, data.plant, data.rig.constants, model,
                               seed, step, data.earlier)
    return Trace(result, data.provenance(seed, command))


def excitation(data: Data, model: Model) -> Excitation:
    """Say whether a recording moves the plant enough for a trace from a model on.

    Args:
        data: the recording.
        model: an analytical one of the rig.

    Raises:
        UserError: the model is not an analytical one, or of another plant than the data.
    """
    from hydro_twin.inference import excitation as exciting

    return exciting.excitation(data.recording, _analytical(model, data))


def _analytical(model: Model, data: Data) -> Model:
    """Take an analytical model to the sample time of the data.

    Raises:
        UserError: it is not one, or of another plant.
    """
    _check_plant(model, data)
    check_analytical(model)
    return model.at(data.recording.sample_time)


def check_analytical(model: Model, source: Path | None = None) -> None:
    """Refuse a model with weights.

    Args:
        model: to check.
        source: its file, if it has one, for the message.

    Raises:
        UserError: it is not an analytical one.
    """
    if not kind_named(model.kind).analytical:
        where = '' if source is None else f'{source}: '
        raise UserError(f'{where}a model of kind {model.kind}; an analytical one is needed')


def _check_plant(model: Model, data: Data) -> None:
    """Refuse a model of another plant than the data."""
    if model.plant.name != data.plant.name:
        raise UserError(f'a model of {model.plant.name}; the data are of {data.plant.name}')


@one_thread()
def replay(data: Data, model: Model | Predictor) -> Replay:
    """Run a model over a recording, in every mode that it has.

    Args:
        data: the recording.
        model: an analytical one; one with weights as `load_predictor` gives it.

    Raises:
        ModelError: the model is not of this sample time and cannot run at it, or has weights.
        UserError: it is of another plant than the data.
    """
    _check_plant(model if isinstance(model, Model) else model.model, data)
    predictor = (model.at(data.recording.sample_time).predictor() if isinstance(model, Model)
                 else model)
    recording = data.recording
    horizon = (horizon_errors(predictor.model, {'all': recording}).get('horizon', {})
               if data.plant.integrates else {})
    replayed = Replay(data.plant, recording, {
        mode: predict(predictor, recording.series, mode) for mode in MODES}, horizon.get('all'))
    if not isinstance(predictor, Analytical):
        return replayed
    replayed = replace(replayed, sensors=sensor_errors(predictor.sensors, data.plant, recording))
    return _with_observer(replayed, predictor) if predictor.model.noise else replayed


def _with_observer(replayed: Replay, predictor: Analytical) -> Replay:
    """Add what the observer predicts, and how well it knows the states."""
    predictions, estimates = zip(*(
        [found[part.offset:part.offset + len(part)] for found in run]
        for part, run in runs_over(predictor.observed, replayed.recording.series)), strict=True)
    return replace(replayed, predictions={**replayed.predictions, OBSERVER: predictions},
                   states=deviations(predictor, estimates))


def _paths(given: Paths) -> list[Path]:
    """Take one path, or many."""
    return [Path(given)] if isinstance(given, Path | str) else [Path(path) for path in given]
