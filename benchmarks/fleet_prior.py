"""What rigs with 3 s of data gain from their group: fits without and with the prior of the others.

    uv run --group dev python -m benchmarks.fleet_prior [--rigs 16]

Rigs of three types are simulated with an independent integrator, and each is fitted by itself.
Its estimate with the group takes the prior from the *other* rigs only. A parameter is poorly
determined where the median of its standard errors is above 10 %. The errors are those against the
truth: root mean squares over the rigs of a type, of the logarithm.
"""
from __future__ import annotations

import argparse
import contextlib
import io
from pathlib import Path
import sys
import tempfile
from typing import Any

import numpy as np

from hydro_twin.api import Data, read_data
from hydro_twin.arrays import FloatArray
from hydro_twin.commands.main import main as hydro_twin
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.parts import parts_of
from hydro_twin.fitting.unknowns import get, label
from hydro_twin.fleet.factors import Rows, rows_of
from hydro_twin.fleet.prior import fit_prior
from hydro_twin.inference.search import LONG, search
from hydro_twin.plants import Plant, plant_named
from hydro_twin.recording.rig import rig_of

TYPES: dict[str, tuple[str, dict[str, float], list[str]]] = {
    'simulator, stiff': ('load_simulator', {'G': 1.4e4, 'J': 0.02},
                         ['u_m=multisine']),
    'simulator, soft': ('load_simulator', {'G': 8e3, 'J': 0.06, 'B_m': 60.0},
                        ['u_m=steps']),
    'valve servo': ('valve_servo', {}, ['command=steps']),
}
SCATTER = 0.05          # between the rigs of a type, of the logarithm of each parameter
DURATION = 3.0          # [s]
SNR = 40.0              # [dB]
POOR = 0.1              # standard error from which a parameter is poorly determined


def main() -> int:
    """Fit, compare, and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--rigs', type=int, default=16, help='of each type')
    count = parser.parse_args().rigs
    ratios = []
    print('type | parameter | std. error | spread | error alone | with the others | ratio')
    for kind in TYPES:
        names, truths, rows, errors = fitted(kind, count)
        alone = np.array([one.solve()[0] for one in rows]) - truths
        others = [fit_prior([*rows[:k], *rows[k + 1:]], np.ones(len(names)))
                  for k in range(count)]
        shrunken = np.array([prior.with_rig(one)[0]
                             for prior, one in zip(others, rows, strict=True)]) - truths
        spread = fit_prior(rows, np.ones(len(names))).spread
        for k, name in enumerate(names):
            poor = np.median(errors[:, k]) > POOR
            by = [float(np.sqrt(np.mean(e[:, k] ** 2))) for e in (alone, shrunken)]
            if poor:
                ratios.append(by[1] / by[0])
            print(f'{kind} | {name}{" (poor)" if poor else ""} | {np.median(errors[:, k]):.3f} | '
                  f'{spread[k]:.3f} | {by[0]:.3f} | {by[1]:.3f} | {by[1] / by[0]:.2f}')
    print(f'{len(ratios)} poorly determined: error with the others over that alone, '
          f'median {np.median(ratios):.2f}, worst {max(ratios):.2f}')
    return 0


def fitted(kind: str, count: int) -> tuple[list[str], FloatArray, list[Rows], FloatArray]:
    """Simulate and fit the rigs of a type.

    Returns:
        Names of what is fitted (p,), the truth (count, p) by the logarithm, what each recording
        says of it, and the standard errors (count, p).
    """
    name, own, excitations = TYPES[kind]
    plant = plant_named(name)
    usual = plant.middle() | own
    truths, records = [], []
    for k in range(count):
        rng = np.random.default_rng([k, *kind.encode()])
        values = {one: value * np.exp(SCATTER * rng.normal()) for one, value in usual.items()}
        data = recorded(plant, values, excitations, k)
        parts = parts_of(data.recording, plant)
        fit = fit_linear(plant, parts, data.rig.constants, data.recording.sample_time, starts=1)
        records.append(record(search(fit.candidate, parts, LONG)))
        truths.append(values)
        print(f'{kind} {k}', file=sys.stderr, flush=True)
    names = [one for one in dict.fromkeys(one for r in records for one in r['names'])
             if one in usual]
    rows = [rows_of(one, names, [True] * len(names)) for one in records]
    errors = np.array([np.sqrt(np.diag(one.solve()[1])) for one in rows])
    return names, np.array([[truth(plant, values, one) for one in names]
                            for values in truths]), rows, errors


def recorded(plant: Plant, values: dict[str, float], excitations: list[str], seed: int) -> Data:
    """Make a recording of a rig by the verb `simulate`, and read it."""
    words = ['simulate', '--plant', plant.name, '--duration', str(DURATION), '--snr', str(SNR),
             '--seed', str(seed)]
    for name, value in values.items():
        words += ['--set', f'{name}={value}']
    for excitation in excitations:
        words += ['--excitation', excitation]
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / 'bag'
        with contextlib.redirect_stdout(io.StringIO()):
            if hydro_twin([*words, '-o', str(bag)]):
                sys.exit('not simulated')
        return read_data([bag], (), rig_of(plant))


def record(fit: Fit) -> dict[str, Any]:
    """Lay out the factor of a fit as the record of a trace has it."""
    known = fit.identifiability()
    unknowns = {label(unknown): unknown for unknown in fit.unknowns}
    values = [get(fit.candidate, unknowns[name]) for name in known.coordinates]
    scale = [value if unknowns[name].log else unknowns[name].scale
             for name, value in zip(known.coordinates, values, strict=True)]
    return {'names': list(known.coordinates), 'values': values,
            'rows': (known.factor / scale).tolist(), 'step': known.step.tolist()}


def truth(plant: Plant, values: dict[str, float], name: str) -> float:
    """Return the logarithm of a parameter; for a combination, of that which stands for it."""
    for combination in plant.combinations:
        if name in combination:
            others = {one: power for one, power in combination.items() if one != name}
            moved = sum(power * np.log(values[one] / plant.middle()[one])
                        for one, power in others.items())
            return float(np.log(values[name]) + combination[name] * moved)
    return float(np.log(values[name]))


if __name__ == '__main__':
    sys.exit(main())
