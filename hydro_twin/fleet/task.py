"""Traces a rig in a period: the work that the engine hands out. Doing it twice does no harm."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import shlex
from time import perf_counter
from typing import Any

from hydro_twin.api import read_data, trace
from hydro_twin.errors import BagError, UserError
from hydro_twin.fleet import store
from hydro_twin.fleet.manifest import Task
from hydro_twin.parallel import on_one_core
from hydro_twin.plants import plant_named
from hydro_twin.recording.digest import source_of
from hydro_twin.recording.rig import Rig, rig_of
from hydro_twin.report.page import parameter_rows
from hydro_twin.result import TraceResult


@dataclass(frozen=True)
class Outcome:
    """What came of a task.

    Attributes:
        record: of the result; None if there is none.
        key: under which it is kept; '' if it is not.
        traced: whether it was made now, and not found.
        reason: why there is none, on one line.
    """

    record: dict[str, Any] | None
    key: str = ''
    traced: bool = False
    reason: str = ''


def run(task: Task, folder: Path, seed: int) -> Outcome:
    """Trace, or find that it is done; keeps to one core.

    Returns:
        What came of it. That the samples do not allow a trace comes back as a reason: trying
        again would not help.

    Raises:
        BagError: a bag cannot be read; a share that was away may be there at a second attempt.
        OSError: likewise, or the result cannot be written.
    """
    try:
        rig = rig_of(plant_named(task.plant), task.config, dict(task.constants))
        key = store.key_of([source_of(bag) for bag in task.bags], rig, seed)
        if (record := store.find(folder, key)) is not None:
            return Outcome(record, key)

        def write(part: Path) -> dict[str, Any]:
            return _trace(task, rig, seed, part)

        with on_one_core():
            return Outcome(store.keep(folder, key, write), key, True)
    except BagError:
        raise
    except UserError as error:
        return Outcome(None, reason=' '.join(str(error).split()))


def _trace(task: Task, rig: Rig, seed: int, folder: Path) -> dict[str, Any]:
    """Trace into a folder; returns the record."""
    begin = perf_counter()
    data = read_data(task.bags, (), rig)
    found = trace(data, None, seed, command=command_of(task, seed))
    summary = found.save(folder)
    values = values_of(found.result, summary)
    return {
        'verdict': summary['verdict'], 'says': summary['says'],
        'error': {when: summary[when][found.result.judged]['test']
                  for when in ('before', 'after')},
        'noise': summary['noise_floor'], 'unit': rig.plant.output.unit,
        'effects': [{name: effect[name] for name in ('id', 'port', 'certain', 'probability',
                                                     'p_value', 'share_of_residual')}
                    for effect in summary['effects']],
        'nothing': summary['nothing'], 'law_unknown': summary['law_unknown'],
        'estimates': {name: one for name, one in values.items() if one['std_error']},
        'factor': factor_of(found.result, values),
        'samples': sum(map(len, data.recording.series)),
        'bags': list(found.provenance['bags']), 'version': found.provenance['version'],
        'seconds': round(perf_counter() - begin, 3),
    }


def values_of(result: TraceResult, summary: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Collect what a trace has estimated: name -> value, standard error or None, unit.

    These are the parameters of the plant after the repair, its combinations where only these are
    known, and those of the effects, as 'backlash at linkage: gap'.
    """
    rows = {row['name']: {**row['after'], 'unit': row['unit'].removesuffix(' / 1')}
            for row in parameter_rows(result, summary['parameters'])}
    for effect in summary['effects']:
        rows |= {f'{effect["id"]} at {effect["port"]}: {name}': values
                 for name, values in effect['parameters'].items()}
    return {name: {what: row[what] for what in ('value', 'std_error', 'unit')}
            for name, row in rows.items()}


def factor_of(result: TraceResult, values: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Lay out the factor of a trace by the names of its values; see `fleet.factors`."""
    plant, after, factor = result.plant, result.after, result.factor
    together = {next(iter(one)): name for one, name in zip(
        plant.combinations, list(values)[len(plant.parameters):], strict=False)}
    powers = {name: power for one in plant.combinations for name, power in one.items()}
    names, at, scale = [], [], []
    for name, index in factor.names:
        if index is not None:
            placed = after.effects[index]
            names.append(f'{placed.effect.id} at {placed.port.name}: {name}')
            at.append(placed.named[name])
            scale.append(1.0)
        else:                   # by the combination that it stands for, if it does
            names.append(together.get(name, name))
            at.append(values[names[-1]]['value'])
            scale.append(powers.get(name, 1) * after.values[name] / at[-1])
    return {'names': names, 'values': at, 'rows': (factor.R * scale).tolist(),
            'step': factor.step.tolist()}


def command_of(task: Task, seed: int) -> str:
    """Write the command that makes the same trace by itself, for the model file."""
    words = ['hydro-twin', 'trace', *map(str, task.bags), '--plant', task.plant]
    words += ['--config', str(task.config)] if task.config else []
    for name, value in task.constants:
        words += ['--constant', f'{name}={value!r}']
    return shlex.join([*words, '--seed', str(seed), '-o', 'out'])
