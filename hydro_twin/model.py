"""The model file: everything needed to run a model, and to know where it came from."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import math
from pathlib import Path
from typing import Any

import yaml

from hydro_twin.effects import Effect, EFFECTS, Placed, sites
from hydro_twin.effects.curve import CURVE, over
from hydro_twin.errors import ModelError, UserError
from hydro_twin.files import write_whole
from hydro_twin.plants import Plant, plant_named, Port
from hydro_twin.plants.plant import FloatArray
from hydro_twin.predictors import kind_named, make_predictor, modes_of, Predictor
from hydro_twin.recording.clock import same
from hydro_twin.recording.series import Series
from hydro_twin.schema import fault

FORMAT = 1
NOT_IDENTIFIABLE = 'not identifiable'
HELD = 'held'
NOT_EXPLAINED = 'not explained'
NOT_REACHED = 'not reached'
MOST_SUBSTEPS = 1024            # in a sample: 2 us at 500 Hz, which no effect needs


@dataclass(frozen=True)
class Estimate:
    """A parameter's value, and how well the data tell it.

    Attributes:
        std_error: standard error in the parameter's unit; None where it is not known.
        identifiable: whether the data determine it at all (by itself, not only in a combination).
        at_bound: 'lower' or 'upper', the edge of the search box at which the fit stopped; or ''.
        held: whether it was taken as known, and not fitted.
    """

    value: float
    std_error: float | None = None
    identifiable: bool = True
    at_bound: str = ''
    held: bool = False


@dataclass(frozen=True)
class FittedEffect:
    """An effect in a model: where it sits, and its parameters by name."""

    placed: Placed
    std_errors: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True)
class Noise:
    """What the observer takes as known of noise, all by maximum likelihood.

    Attributes:
        measurement: standard deviation of the measured output, in its unit.
        process: intensity of white noise on the rates of states, by name, in the state's SI unit
            over the root of a second; zero where there is none.
        start: standard deviation of each state at the begin of a run, by name, in its SI unit.
    """

    measurement: float
    process: Mapping[str, float]
    start: Mapping[str, float]


@dataclass(frozen=True)
class Model:
    """A plant with values, effects, and perhaps a network beside.

    Attributes:
        kind: name of the predictor that runs it.
        timing: how late each input acts [s], by name: what the stamps cannot tell (see docs).
        substeps: integration steps in a sample, chosen by error when the model was fitted.
        noise: for the observer; None: it cannot run.
        network: name of the weights file beside the model file.
        errors: {'before' and 'after': {'one_step', 'free_run' and, with noise, 'observer':
            {'train', 'test'}}}, in the unit of the output.
        provenance: bags with their SHA-256, command, seed, version.
        notes: what a reader of the values must know, a sentence each.
    """

    plant: Plant
    parameters: Mapping[str, Estimate]
    constants: Mapping[str, float]
    sample_time: float
    kind: str = 'analytical'
    effects: tuple[FittedEffect, ...] = ()
    timing: Mapping[str, float] = field(default_factory=dict)
    substeps: int = 4
    noise: Noise | None = None
    network: str | None = None
    errors: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """Parameters and constants by name."""
        return {**self.constants, **{name: p.value for name, p in self.parameters.items()}}

    @property
    def placed(self) -> tuple[Placed, ...]:
        """The effects as the kernel takes them."""
        return tuple(effect.placed for effect in self.effects)

    def at(self, sample_time: float) -> Model:
        """Return the same physics at another sample time [s].

        The laws are integrated with steps no longer than before, and eq. 1 is that of the new
        sample time. The errors are those at the old one.

        Raises:
            ModelError: the model has a network, which knows its own sample time only.
        """
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

    def promised(self, mode: str) -> float | None:
        """RMS error that the model had on data it did not fit; None where it does not say."""
        after = self.errors.get('after', {}).get(mode, {})
        value = after.get('test', after.get('train'))
        return float(value) if value is not None and math.isfinite(value) else None


def effect_at(identifier: str, port_name: str, plant: Plant) -> tuple[Effect, Port]:
    """Find the effect of that id and the port of that name on which it sits.

    Raises:
        ModelError: there is none.
    """
    for effect in EFFECTS:
        for port in sites(effect, plant):
            if effect.id == identifier and port.name == port_name:
                return effect, port
    possible = sorted({f'{effect.id}@{port.name}' for effect in EFFECTS
                       for port in sites(effect, plant)})
    raise ModelError(f'{plant.name} takes no effect {identifier} at port {port_name}; '
                     f'it takes {", ".join(possible)}')


def place(identifier: str, port_name: str, parameters: Mapping[str, float],
          plant: Plant) -> Placed:
    """Put an effect with these parameters on a port; refinements left out are neutral.

    Raises:
        ModelError: no such effect there, or a parameter missing, unknown or out of range.
    """
    return _filled(*effect_at(identifier, port_name, plant), parameters)


def curve_at(port_name: str, kind: str, signal: str, plant: Plant) -> tuple[Effect, Port]:
    """Give the curve over a signal at the port of that name and kind.

    Raises:
        ModelError: no such port or signal.
    """
    for port in plant.ports:
        if (port.name, port.kind) == (port_name, kind) and signal in ('value', *port.signals):
            return over(port, signal), port
    raise ModelError(f'{plant.name} takes no curve over {signal} at port {port_name} ({kind})')


def _filled(effect: Effect, port: Port, parameters: Mapping[str, float]) -> Placed:
    """Give an effect its parameters, each within its range.

    Raises:
        ModelError: a parameter is missing, unknown or out of range.
    """
    identifier = effect.id
    known = {parameter.name for parameter in effect.parameters}
    if unknown := sorted(set(parameters) - known):
        raise ModelError(f'effect {identifier} has no parameter {", ".join(unknown)}; '
                         f'it has {", ".join(sorted(known))}')
    values = []
    for p in effect.parameters:
        neutral = p.unreached if p.refinement is None else p.refinement
        value = parameters.get(p.name, neutral)
        if value is None:
            raise ModelError(f'effect {identifier}: parameter {p.name} is missing')
        if not p.lower <= value <= p.upper:
            raise ModelError(f'effect {identifier}: {p.name} = {value:g} is outside '
                             f'{p.lower:g} to {p.upper:g}')
        values.append(float(value))
    if effect.id == CURVE.id and not values[0] < values[1]:
        raise ModelError(f'effect {identifier}: low = {values[0]:g} must be below '
                         f'high = {values[1]:g}')
    return Placed(effect, port, tuple(values))


def document(model: Model) -> dict[str, Any]:
    """Lay a model out as the plain structure of its file."""
    plant = model.plant
    units = {p.name: p.unit for p in plant.parameters}
    units |= {c.name: c.unit for c in plant.constants}
    return {
        'format': FORMAT,
        'plant': plant.name,
        'predictor': model.kind,
        'sample_time': model.sample_time,
        'substeps': model.substeps,
        'constants': {name: {'value': value, 'unit': units[name]}
                      for name, value in model.constants.items()},
        'parameters': {
            name: {'value': p.value, 'unit': units[name],
                   'std_error': HELD if p.held else p.std_error if p.identifiable
                   else NOT_IDENTIFIABLE,
                   **({'at_bound': p.at_bound} if p.at_bound else {})}
            for name, p in model.parameters.items()},
        'timing': dict(model.timing),
        'effects': [{
            'id': effect.placed.effect.id,
            'port': effect.placed.port.name,
            **_found(effect.placed),
            'parameters': {
                p.name: {'value': value, 'unit': effect.placed.effect.unit(p, effect.placed.port),
                         'std_error': (NOT_REACHED if value == p.unreached else
                                       effect.std_errors.get(p.name))}
                for p, value in zip(effect.placed.effect.parameters, effect.placed.values,
                                    strict=True)
                if value != p.refinement},
        } for effect in model.effects],
        **({'observer': {'measurement_noise': model.noise.measurement,
                         'process_noise': dict(model.noise.process),
                         'start': dict(model.noise.start)}} if model.noise else {}),
        'network': model.network,
        **({'notes': list(model.notes)} if model.notes else {}),
        'errors': dict(model.errors),
        'provenance': dict(model.provenance),
    }


def _found(placed: Placed) -> dict[str, str]:
    """Say of a curve over which signal it is, and that it explains nothing."""
    if placed.effect.named:
        return {}
    return {'kind': placed.port.kind, 'signal': placed.effect.reads[0], 'found': NOT_EXPLAINED}


def write_model(model: Model, path: Path) -> None:
    """Write a model file, whole or not at all.

    Raises:
        ModelError: the file cannot be written there.
    """
    text = yaml.safe_dump(document(model), sort_keys=False, allow_unicode=True)
    try:
        write_whole(path, text)
    except OSError as error:
        raise ModelError(f'{path}: cannot be written ({error.strerror})') from error


def read_model(path: Path) -> Model:
    """Read a model file and check all of it.

    Raises:
        ModelError: not there, damaged, of another format, or not physical; one line says which.
    """
    try:
        raw = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ModelError(f'{path}: no model file can be read there ({error.strerror})') from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ModelError(f'{path}: not a YAML file: {str(error).splitlines()[0]}') from error
    if not isinstance(raw, dict) or 'format' not in raw:
        raise ModelError(f'{path}: not a model file (no "format" in it)')
    if raw['format'] != FORMAT:
        raise ModelError(f'{path}: format {raw["format"]!r}; this version reads {FORMAT}')
    try:
        model = _from_document(raw)
        if wrong := fault(raw, 'model'):
            raise ModelError(f'damaged ({wrong})')
        return model
    except UserError as error:
        raise ModelError(f'{path}: {error}') from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ModelError(f'{path}: damaged ({type(error).__name__}: {error})') from error


def load_predictor(path: Path, sample_time: float | None = None) -> Predictor:
    """Read a model file and make its predictor.

    Args:
        path: of the model file.
        sample_time: [s] at which it is to run; its own by default.

    Raises:
        ModelError: the file or its weights are missing or cannot be used, or the model has a
            network, which cannot run at that sample time; one line says which.
    """
    model = read_model(path)
    if model.network and not (path.parent / model.network).is_file():
        raise ModelError(f'{path}: its weights file {model.network} is missing: copy it to the '
                         f'folder of the model, {path.parent}')
    if sample_time is not None:
        try:
            model = model.at(sample_time)
        except ModelError as error:
            raise ModelError(f'{path}: {error}') from error
    return make_predictor(model, path.parent)


def _from_document(raw: Mapping[str, Any]) -> Model:
    plant = plant_named(raw['plant'])
    constants = {name: _number(f'constant {name}', c['value'])
                 for name, c in (raw.get('constants') or {}).items()}
    estimates = {}
    for name, p in raw['parameters'].items():
        spread = p.get('std_error')
        estimates[name] = Estimate(
            _number(name, p['value']),
            None if spread in (None, NOT_IDENTIFIABLE, HELD) else _number(name, spread),
            spread not in (NOT_IDENTIFIABLE, HELD), str(p.get('at_bound') or ''), spread == HELD)
    kind = kind_named(raw.get('predictor', 'analytical'))
    if estimates or kind.physics:
        plant.check({name: p.value for name, p in estimates.items()})
    effects = tuple(
        FittedEffect(
            _filled(*(curve_at(e['port'], e['kind'], e['signal'], plant)
                      if e['id'] == CURVE.id else effect_at(e['id'], e['port'], plant)),
                    {name: _number(f'effect {e["id"]}: {name}', p['value'])
                     for name, p in e['parameters'].items()}),
            {name: None if p.get('std_error') == NOT_REACHED else p.get('std_error')
             for name, p in e['parameters'].items()})
        for e in raw.get('effects') or ())
    timing = {name: _number(f'timing of {name}', t) for name, t in
              (raw.get('timing') or {}).items()}
    if unknown := sorted(set(timing) - {signal.name for signal in plant.inputs}):
        raise ModelError(f'timing of {", ".join(unknown)}: no such input of {plant.name}')
    sample_time = _number('sample_time', raw['sample_time'])
    substeps = raw.get('substeps', 4)
    if sample_time <= 0 or not isinstance(substeps, int) or not 1 <= substeps <= MOST_SUBSTEPS:
        raise ModelError(f'sample_time {sample_time} must be above 0 and substeps {substeps} '
                         f'a whole number from 1 to {MOST_SUBSTEPS}')
    if 'observer' in raw and not kind.analytical:
        raise ModelError(f'observer: a model of kind {kind.name} has none')
    return Model(
        plant=plant, parameters=estimates, constants=plant.constant_values(constants),
        sample_time=sample_time, kind=kind.name, effects=effects, timing=timing, substeps=substeps,
        noise=_noise(raw['observer'], plant) if 'observer' in raw else None,
        network=raw.get('network'), errors=raw.get('errors') or {},
        provenance=raw.get('provenance') or {}, notes=tuple(map(str, raw.get('notes') or ())))


def _noise(raw: Mapping[str, Any], plant: Plant) -> Noise:
    """Check the section of the observer.

    Raises:
        ModelError: a state that the plant does not have, or one missing, or no noise there is.
    """
    process, start = ({name: _number(f'observer: {key} of {name}', value)
                       for name, value in raw[key].items()} for key in ('process_noise', 'start'))
    noise = Noise(_number('observer: measurement_noise', raw['measurement_noise']), process, start)
    if not set(process) <= set(start) == set(plant.states):
        raise ModelError(f'observer: the states of {plant.name} are {", ".join(plant.states)}')
    if not (0.0 < noise.measurement < math.inf
            and all(0.0 <= value < math.inf for value in (*process.values(), *start.values()))):
        raise ModelError('observer: measurement_noise must be above 0, process_noise and start at '
                         'least 0, and all finite')
    return noise


def _number(name: str, value: object) -> float:
    """Take a finite number, or infinity where a law allows it."""
    if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
        raise ModelError(f'{name}: {value!r} is not a number')
    return float(value)
