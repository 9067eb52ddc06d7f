"""The best a tracer could do: the true structure of a rig, fitted from its true parameters."""
from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

import numpy as np

from benchmarks.tracing.draws import Built
from benchmarks.tracing.rigs import BOX, Rig
from hydro_twin.effects import EFFECTS, Placed
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.output_error import residuals
from hydro_twin.fitting.parts import parts_of
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import effect_unknowns, plant_unknowns, timing_unknowns
from hydro_twin.model import Model
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.scores import errors_by_series, rms
from hydro_twin.predictors.system import LINEAR
from hydro_twin.recording.series import Recording, split

# what 'single' laws are in the library: kind of port, and parameters from the fields built in
_IN_LIBRARY: dict[str, tuple[str, Callable[[dict[str, Any]], dict[str, float]]]] = {
    'coulomb': ('force', lambda f: {'coulomb': f['coulomb']}),
    'stribeck': ('force', lambda f: {'coulomb': f['coulomb'],
                                     'stribeck': f['static'] - f['coulomb'],
                                     'stribeck_velocity': f['stribeck']}),
    'overlap': ('opening', lambda f: {'width': f['dead_low']}),
    'gap': ('coupling', lambda f: {'gap': f['gap']}),
    'window_end': ('opening', lambda f: {'lower': -f['stroke'], 'upper': f['stroke']}),
    'command_limit': ('command', lambda f: {'lower': -f['command_limit'],
                                            'upper': f['command_limit']}),
    'spool_rate': ('rate', lambda f: {'limit': f['rate']}),
    'command_play': ('command', lambda f: {'width': f['command_play']}),
    'spool_play': ('opening', lambda f: {'width': f['play']}),
    'pure_delay': ('command', lambda f: {'time': f['delay']}),
    'uneven_gain': ('flow', lambda f: {'imbalance': f['asymmetry']}),
    'null_shift': ('command', lambda f: {'offset': f['command_bias']}),
    'torque_bias': ('force', lambda f: {'offset': -f['torque_bias']}),
    'sensor_bias': ('sensor', lambda f: {'offset': f['sensor_bias']}),
    'square_root': ('flow', lambda f: {'supply_pressure': f['supply_high']}),
    'turbulent': ('leakage', lambda f: {'flow': 1e3 * f['leak_root'], 'exponent': 0.5}),
    'cubic': ('coupling', lambda f: {'cubic': f['cubic']}),
    'sine_ripple': ('force', lambda f: {
        'cosine': -f['ripple'] * math.sin(f['ripple_phase']),
        'sine': -f['ripple'] * math.cos(f['ripple_phase']), 'periods': f['ripple_order']}),
}


def true_structure(rig: Rig, substeps: int = 8) -> Model:
    """Return the rig as the product would describe it; with effects of the library only."""
    sample_time = rig.recording().series[0].sample_time
    values = {name: getattr(rig.truth.laws, name) for name in (*BOX, 'D_m')}
    placed = tuple(_placed(built) for built in rig.truth.built)
    return Model(LOAD_SIMULATOR, values, sample_time, placed,
                 interpolation=rig.truth.interpolation, substeps=substeps)


def true_fit(rig: Rig) -> Fit:
    """Fit the true structure to the training part."""
    return _fitted(true_structure(rig), rig)


def error_on_test(fit: Fit, rig: Rig) -> float:
    """Return the free-run error of a fit on the test part of its rig, as a report has it [N m].

    From rest, as a free run begins, also where the rig moves at the start.
    """
    _, test = split(rig.recording())
    errors = errors_by_series(Analytical(fit.candidate), test.series, 'free_run')
    return rms(np.concatenate(errors))


def shows_beside(whole: Fit, rig: Rig) -> dict[str, float]:
    """Return for each effect how far the error of the training part rises where it is left out.

    Relative to the fit of the true structure, from whose parameters the fit without it begins.
    """
    return {placed.effect.id: _fitted(whole.candidate.without(k), rig).error / whole.error - 1.0
            for k, placed in enumerate(whole.candidate.effects)}


def _fitted(start: Model, rig: Rig) -> Fit:
    unknowns = plant_unknowns(start.plant, 'physical')
    for i, placed in enumerate(start.effects):
        unknowns += effect_unknowns(i, placed)
    if start.interpolation == LINEAR:
        unknowns += timing_unknowns(start)
    train, _ = split(rig.recording())
    return Problem(start, unknowns, parts_of(train, start.plant)).solve()


def error(candidate: Model, recording: Recording) -> float:
    """Return the free run's error over all series [N m]."""
    parts = parts_of(recording, candidate.plant)
    return rms(np.concatenate(residuals(candidate, parts)))


def _placed(built: Built) -> Placed:
    kind, of = _IN_LIBRARY[built.law]
    effect = next(e for e in EFFECTS if e.id == built.id and kind in e.kinds)
    port = next(p for p in LOAD_SIMULATOR.ports if p.kind == kind)
    neutral = {p.name: p.refinement for p in effect.parameters if p.refinement is not None}
    given = {**neutral, **of(built.fields)}
    return Placed(effect, port, tuple(given[p.name] for p in effect.parameters))
