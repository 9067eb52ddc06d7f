"""The model file: everything needed to run a model, and to know where it came from."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from pathlib import Path
from typing import Any

import yaml

from hydro_twin.effects import Placed
from hydro_twin.effects.curve import CURVE
from hydro_twin.errors import ModelError, UserError
from hydro_twin.files import write_whole
from hydro_twin.model.placing import curve_at, effect_at, filled
from hydro_twin.model.value import Model, MOST_SUBSTEPS, Noise, Record, Uncertainty
from hydro_twin.plants import Plant, plant_named
from hydro_twin.predictors import kind_named, Predictor
from hydro_twin.predictors.system import HOLD, LINEAR
from hydro_twin.schema import fault

FORMAT = 1
NOT_IDENTIFIABLE = 'not identifiable'
HELD = 'held'
NOT_EXPLAINED = 'not explained'
NOT_REACHED = 'not reached'


def document(model: Model) -> dict[str, Any]:
    """Lay a model out as the plain structure of its file."""
    plant, record = model.plant, model.record
    units = _units(plant)
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
        'interpolation': model.interpolation,
        'effects': [{
            'id': placed.effect.id,
            'port': placed.port.name,
            **_found(placed),
            'parameters': {
                p.name: {'value': value, 'unit': placed.effect.unit(p, placed.port),
                         'std_error': (NOT_REACHED if value == p.unreached else
                                       record.std_error(k, p.name))}
                for p, value in zip(placed.effect.parameters, placed.values, strict=True)
                if value != p.refinement},
        } for k, placed in enumerate(model.effects)],
        **({'observer': _noise_entry(model.noise)} if model.noise else {}),
        'network': model.network,
        **({'notes': list(record.notes)} if record.notes else {}),
        'errors': dict(record.errors),
        'provenance': dict(record.provenance),
    }


def _noise_entry(noise: Noise) -> dict[str, Any]:
    """Lay out what the observer takes as known of noise."""
    return {
        'measurement_noise': noise.measurement,
        'process_noise': dict(noise.process),
        'start': dict(noise.start),
        **({'follow': dict(noise.follow)} if noise.follow else {}),
        **({'sensor_noise': dict(noise.sensors)} if noise.sensors else {}),
        **({'innovation': noise.innovation} if noise.innovation is not None else {}),
    }


def _units(plant: Plant) -> dict[str, str]:
    """Give the unit of each parameter and constant of a plant."""
    return {p.name: p.unit for p in plant.parameters} | {c.name: c.unit for c in plant.constants}


def _found(placed: Placed) -> dict[str, str]:
    """Say of a curve over which signal it is, and that it explains nothing."""
    if placed.effect.explains:
        return {}
    return {'kind': placed.port.kind, 'signal': placed.effect.reads[0], 'found': NOT_EXPLAINED}


def write_model(model: Model, path: Path) -> None:
    """Write a model file atomically.

    Raises:
        ModelError: the file cannot be written there.
    """
    text = yaml.safe_dump(document(model), sort_keys=False, allow_unicode=True)
    try:
        write_whole(path, text)
    except OSError as error:
        raise ModelError(f'{path}: cannot be written ({error.strerror})') from error


def read_model(path: Path | str) -> Model:
    """Read a model file and check all of it.

    Raises:
        ModelError: not there, damaged, of another format, or not physical; one line says which.
    """
    path = Path(path)
    try:
        raw = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ModelError(f'{path}: no model file can be read there ({error.strerror})') from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
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


def load_predictor(path: Path | str, sample_time: float | None = None,
                   follow: Sequence[str] = ()) -> Predictor:
    """Read a model file and make its predictor.

    Args:
        path: of the model file.
        sample_time: [s] at which it is to run; its own by default.
        follow: parameters that its observer is to follow, if it has one, NAME or NAME=RATE; none:
            those of the file.

    Raises:
        ModelError: the file or its weights are missing or cannot be used, the model has a network
            and is asked for another sample time, or a rate is not a positive number; one line says
            which. Whether the model has the parameters to follow is checked when its observer
            first runs.
    """
    path = Path(path)
    model = read_model(path)
    if model.network and not (path.parent / model.network).is_file():
        raise ModelError(f'{path}: its weights file {model.network} is missing: copy it to the '
                         f'folder of the model, {path.parent}')
    if sample_time is not None:
        try:
            model = model.at(sample_time)
        except ModelError as error:
            raise ModelError(f'{path}: {error}') from error
    if any(follow) and model.noise is not None:
        from hydro_twin.predictors.follow import parse

        model = replace(model, noise=replace(model.noise, follow=parse(follow)))
    return model.predictor(path.parent)


def _from_document(raw: Mapping[str, Any]) -> Model:
    plant, kind = plant_named(raw['plant']), kind_named(raw.get('predictor', 'analytical'))
    units = _units(plant)
    constants = {name: _quantity(f'constant {name}', c, units.get(name))
                 for name, c in (raw.get('constants') or {}).items()}
    parameters = {name: _quantity(name, p, units.get(name))
                  for name, p in raw['parameters'].items()}
    uncertainty = {name: _uncertainty(name, p) for name, p in raw['parameters'].items()}
    if parameters or kind.physics:
        plant.check(parameters)
    effects = []
    for k, e in enumerate(raw.get('effects') or ()):
        at = (curve_at(e['port'], e['kind'], e['signal'], plant) if e['id'] == CURVE.id else
              effect_at(e['id'], e['port'], plant))
        units = {p.name: at[0].unit(p, at[1]) for p in at[0].parameters}
        effects.append(filled(*at, {
            name: _quantity(f'effect {e["id"]}: {name}', p, units.get(name), finite=False)
            for name, p in e['parameters'].items()}))
        uncertainty |= {
            f'{k}:{name}': Uncertainty(std_error=None if spread == NOT_REACHED else spread)
            for name, p in e['parameters'].items() for spread in [p.get('std_error')]}
    timing = {name: _number(f'timing of {name}', t) for name, t in
              (raw.get('timing') or {}).items()}
    if unknown := sorted(set(timing) - {signal.name for signal in plant.inputs}):
        raise ModelError(f'timing of {", ".join(unknown)}: no such input of {plant.name}')
    interpolation = raw.get('interpolation', HOLD)
    if interpolation not in (HOLD, LINEAR):
        raise ModelError(f'interpolation {interpolation} must be {HOLD} or {LINEAR}')
    sample_time = _number('sample_time', raw['sample_time'])
    substeps = raw.get('substeps', 4)
    if sample_time <= 0 or not isinstance(substeps, int) or not 1 <= substeps <= MOST_SUBSTEPS:
        raise ModelError(f'sample_time {sample_time} must be above 0 and substeps {substeps} '
                         f'a whole number from 1 to {MOST_SUBSTEPS}')
    if early := sorted(name for name, late in timing.items() if late < -sample_time):
        raise ModelError(f'timing of {", ".join(early)}: earlier than a sample')
    if 'observer' in raw and not kind.analytical:
        raise ModelError(f'observer: a model of kind {kind.name} has none')
    return Model(
        plant, {**plant.constant_values(constants), **parameters}, sample_time, tuple(effects),
        timing, interpolation, substeps, kind.name,
        _noise(raw['observer'], plant) if 'observer' in raw else None, raw.get('network'),
        Record(uncertainty, raw.get('errors') or {}, raw.get('provenance') or {},
               tuple(map(str, raw.get('notes') or ()))))


def _uncertainty(name: str, p: Mapping[str, Any]) -> Uncertainty:
    """Read how well a parameter of the plant is known."""
    spread = p.get('std_error')
    return Uncertainty(
        std_error=None if spread in (None, NOT_IDENTIFIABLE, HELD) else _number(
            f'std_error of {name}', spread, finite=False),
        identifiable=spread not in (NOT_IDENTIFIABLE, HELD), at_bound=str(p.get('at_bound') or ''),
        held=spread == HELD)


def _noise(raw: Mapping[str, Any], plant: Plant) -> Noise:
    """Check the section of the observer.

    Raises:
        ModelError: a state or sensor that the plant does not have, or a state missing, or no noise
            there is.
    """
    process, start = ({name: _number(f'observer: {key} of {name}', value)
                       for name, value in raw[key].items()} for key in ('process_noise', 'start'))
    follow = {name: _number(f'observer: follow {name}', rate)
              for name, rate in (raw.get('follow') or {}).items()}
    sensors = {name: _number(f'observer: sensor_noise of {name}', value)
               for name, value in (raw.get('sensor_noise') or {}).items()}
    innovation = (_number('observer: innovation', raw['innovation']) if 'innovation' in raw
                  else None)
    noise = Noise(_number('observer: measurement_noise', raw['measurement_noise']), process, start,
                  follow, sensors, innovation)
    if unknown := sorted(sensors.keys() - {sensor.name for sensor in plant.sensors}):
        raise ModelError(f'observer: {plant.name} has no sensor {", ".join(unknown)}')
    if not set(process) <= set(start) == set(plant.states):
        raise ModelError(f'observer: the states of {plant.name} are {", ".join(plant.states)}')
    others = (*process.values(), *start.values(), *follow.values())
    if not (all(value > 0.0 for value in (
            noise.measurement, *sensors.values(), 1.0 if innovation is None else innovation))
            and all(value >= 0.0 for value in others)):
        raise ModelError('observer: measurement_noise, sensor_noise and innovation must be above '
                         '0, process_noise, start and follow at least 0')
    return noise


def _quantity(name: str, given: Mapping[str, Any], unit: str | None, finite: bool = True
              ) -> float:
    """Take the value of an entry, if its unit, where it has one, is the one that counts.

    Args:
        name: for messages.
        given: the entry, with its value.
        unit: that the value must be in; None where the name is unknown, which is refused later.
        finite: whether it must be; a limit that is not reached is infinite.
    """
    if unit is not None and str(given.get('unit') or unit) != unit:
        raise ModelError(f'{name}: its unit must be {unit}, not {given["unit"]}')
    return _number(name, given['value'], finite)


def _number(name: str, value: object, finite: bool = True) -> float:
    """Take a number, finite or not."""
    if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
        raise ModelError(f'{name}: {value!r} is not a number{_as_yaml(value)}')
    if finite and math.isinf(value):
        raise ModelError(f'{name}: must be finite')
    return float(value)


def _as_yaml(value: object) -> str:
    """Say how to write a number that YAML 1.1 takes for text, as 1.1e5; '' if it is none."""
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        number = math.nan
    return '' if math.isnan(number) else f' to YAML; write {number:e}'
