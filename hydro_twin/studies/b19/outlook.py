"""The outlook of [B19]: higher frequencies of u_m, and a recurrent network."""
from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast, TYPE_CHECKING

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.commands import import_, simulate
from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.network import Job, SETTINGS, train_many
from hydro_twin.fitting.refit import network_problem
from hydro_twin.fitting.regression import regressors
from hydro_twin.model import Model
from hydro_twin.plants import Plant
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.network_predictor import NetworkPredictor
from hydro_twin.predictors.predictor import MODES
from hydro_twin.recording.rig import read, Rig, rig_of
from hydro_twin.recording.series import Recording, Series
from hydro_twin.share import share_folder
from hydro_twin.studies.b19.populations import fit_one_step
from hydro_twin.studies.b19.study import make_part, model_of, scores

if TYPE_CHECKING:
    from hydro_twin.predictors.predictor import Predictor

FREQUENCIES = (15, 25, 40)          # of u_m [Hz]: above those of the paper
# The rig of bags/load_simulator_nonlinear, as in bags/make.sh.
RIG = ('--snr 40 --quantisation 0.015625 --duration 3 --set B_m=95 --set J=0.02 --set K_p=0.025 '
       '--effect backlash@coupling:gap=1e-3 --effect friction@motor:coulomb=40 '
       '--effect dead_zone@spool:width=5e-6 --effect orifice@flow:supply_pressure=6e6 '
       '--excitation theta_d=random:bandwidth=60,amplitude=0.01 '
       '--burst theta_d:begin=2,length=0.3,frequency=110,amplitude=0.007')
LEG = ('policy1_sin1Hz', 'policy1_sin_sweep')

Errors = dict[str, dict[str, list[float]]]      # recording -> mode -> errors of the runs


def at_higher_frequencies(folder: Path, rig: Rig) -> Recording:
    """Simulate the rig of the sample recording with u_m at FREQUENCIES, into a new folder."""
    arguments = ['--plant', rig.plant.name, '--seed', '8', *RIG.split(), '-o', str(folder)]
    for frequency in FREQUENCIES:
        arguments += ['--excitation', f'u_m=sine:frequency={frequency}']
    simulate.run(_parsed(simulate, arguments))
    return read([folder], rig)


def leg(data: Path, folder: Path, plant: str) -> tuple[list[Recording], Rig]:
    """Import the measured recordings LEG, and say on which rig they are."""
    from hydro_twin.plants import plant_named

    config = share_folder() / 'config' / 'measured'
    rig = rig_of(plant_named(plant), config / 'leg_rig.yaml')
    for name in LEG:
        if not (folder / name).exists():
            import_.run(_parsed(import_, [str(data / f'{name}.csv.gz'), '-o', str(folder / name),
                                          '--map', str(config / 'leg.yaml')]))
    return [read([folder / name], rig) for name in LEG], rig


def _parsed(verb: Any, arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    return parser.parse_args(arguments)


@dataclass(frozen=True)
class Arx:
    """The 14 coefficients of eq. 1 without physics, as a predictor."""

    model: Model
    coefficients: FloatArray

    @property
    def plant(self) -> Plant:
        """The plant whose order and signals it has."""
        return self.model.plant

    def one_step(self, series: Series) -> FloatArray:
        """Predict each sample from those before; nan for the first order + 1."""
        rows = self._rows(series)
        return np.concatenate([np.full(self.plant.order + 1, np.nan), rows @ self.coefficients])

    def free_run(self, series: Series) -> FloatArray:
        """Feed the output back, from rest at the first measured one."""
        order, y = self.plant.order, series[self.plant.output.name].copy()
        driven = self._rows(series)[:, order:] @ self.coefficients[order:]
        y[:order + 1] = y[0]
        for k, drive in enumerate(driven, order + 1):
            y[k] = drive + self.coefficients[:order] @ y[k - order:k][::-1]
        return y

    def _rows(self, series: Series) -> FloatArray:
        inputs = [signal.name for signal in self.plant.inputs]
        return np.concatenate(list(regressors(series, self.plant.output.name, inputs,
                                              self.plant.order)))[:, :-1]


def predictors(
    train: Recording, tests: Mapping[str, Recording], rig: Rig, seeds: Sequence[int], device: str,
    kinds: Sequence[str] = ('least_squares', 'mlp', 'hybrid', 'gru'),
) -> dict[str, Errors]:
    """Train predictors, and score them on several recordings.

    Returns:
        Errors by method, recording and mode: of repeating the last sample, of 14 coefficients
        without physics, and of the kinds.
    """
    plant, constants = rig.plant, rig.constants
    parts = {name: make_part(name, recording, plant) for name, recording in tests.items()}
    factor = make_part('training', train, plant).factor
    empty = Model(plant, constants, train.sample_time, kind='mlp')
    found: dict[str, Errors] = {
        'persistence': {name: {'one_step': [part.factor.persistence()]}
                        for name, part in parts.items()},
        'unconstrained': _scored([Arx(empty, factor.best())], train, tests)}
    models = {'mlp': empty, 'gru': replace(empty, kind='gru')}
    if 'least_squares' in kinds:
        best = fit_one_step('least_squares', factor,
                            coefficients_of(plant, constants, train.sample_time), plant,
                            seeds[0]).best
        base = model_of('analytical', best, plant, constants, train.sample_time)
        models['hybrid'] = replace(base, kind='hybrid')
        found['least_squares'] = _scored([Analytical(base)], train, tests)
    for kind in kinds:
        if kind == 'least_squares':
            continue
        model = models[kind]
        jobs = [Job(SETTINGS[kind], seed) for seed in seeds]
        made = [NetworkPredictor(model, trained.network)
                for trained in train_many(network_problem(train, model), jobs, device)]
        found[kind] = _scored(made, train, tests)
    return found


def _scored(
    made: Sequence[Analytical | NetworkPredictor | Arx], train: Recording,
    tests: Mapping[str, Recording],
) -> Errors:
    found: Errors = {}
    for name, test in tests.items():
        parts = {'train': train, 'test': test}
        each = [scores(cast('Predictor', predictor), parts) for predictor in made]  # offline
        found[name] = {mode: [errors['test', mode] for errors in each] for mode in MODES}
    return found
