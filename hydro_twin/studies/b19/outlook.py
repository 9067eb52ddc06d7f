"""The outlook of [B19]: higher frequencies of u_m, and a recurrent network."""
from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hydro_twin.commands import import_, simulate
from hydro_twin.commands.common import read, Rig, rig_of
from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.network import Job, SETTINGS, train_many
from hydro_twin.fitting.populations import fit_one_step
from hydro_twin.fitting.refit import network_problem
from hydro_twin.model import Model
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.hybrid import NetworkPredictor
from hydro_twin.recording.series import Recording
from hydro_twin.share import share_folder
from hydro_twin.studies.b19.study import make_part, model_of, scores

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


def leg(data: Path, folder: Path, plant: str) -> tuple[Recording, Rig]:
    """Import the measured recordings of the leg, and say on which rig they are."""
    from hydro_twin.plants import plant_named

    config = share_folder() / 'config' / 'measured'
    rig = rig_of(plant_named(plant), config / 'leg_rig.yaml')
    rig = replace(rig, plant=replace(rig.plant, sample_time=rig.sample_time))
    bags = []
    for name in LEG:
        bags.append(folder / name)
        if bags[-1].exists():
            continue
        import_.run(_parsed(import_, [str(data / f'{name}.csv.gz'), '-o', str(bags[-1]),
                                      '--map', str(config / 'leg.yaml')]))
    return read(bags, rig), rig


def _parsed(verb: Any, arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    return parser.parse_args(arguments)


def predictors(
    train: Recording, tests: Mapping[str, Recording], rig: Rig, seeds: Sequence[int], device: str,
) -> dict[str, Errors]:
    """Train least squares, MLP, hybrid and GRU, and score them on several recordings.

    Returns:
        Errors by method, recording and mode; 'persistence' and 'unconstrained' by one step only.
    """
    plant, constants = rig.plant, rig.constants
    parts = {name: make_part(name, recording, plant) for name, recording in tests.items()}
    factor = make_part('training', train, plant).factor
    free = factor.best()
    found: dict[str, Errors] = {
        'persistence': {name: {'one_step': [part.factor.persistence()]}
                        for name, part in parts.items()},
        'unconstrained': {name: {'one_step': [float(part.factor.rms(free))]}
                          for name, part in parts.items()}}
    best = fit_one_step('least_squares', factor,
                        coefficients_of(plant, constants, plant.sample_time), plant,
                        seeds[0]).best
    base = model_of('analytical', best, plant, constants)
    found['least_squares'] = _scored([Analytical(base)], train, tests)
    for kind in ('mlp', 'hybrid', 'gru'):
        model = (model_of('hybrid', best, plant, constants) if kind == 'hybrid'
                 else Model(plant, {}, constants, plant.sample_time, kind))
        jobs = [Job(SETTINGS[kind], seed) for seed in seeds]
        made = [NetworkPredictor(model, trained.network)
                for trained in train_many(network_problem(train, model), jobs, device)]
        found[kind] = _scored(made, train, tests)
    return found


def _scored(
    made: Sequence[Analytical | NetworkPredictor], train: Recording,
    tests: Mapping[str, Recording],
) -> Errors:
    return {name: {mode: [scores(predictor, {'train': train, 'test': test})['test', mode]
                          for predictor in made] for mode in ('one_step', 'free_run')}
            for name, test in tests.items()}
