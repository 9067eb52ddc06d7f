"""Weight decay and structure of the study's networks, chosen on validation data, Sect. 3.2."""
from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from hydro_twin.fitting.coefficients import coefficients_of
from hydro_twin.fitting.network import SETTINGS
from hydro_twin.fitting.network_search import Round, search
from hydro_twin.fitting.refit import network_problem
from hydro_twin.model import Model
from hydro_twin.plants import Plant
from hydro_twin.predictors.kind import Settings
from hydro_twin.recording.series import Recording
from hydro_twin.studies.b19.populations import fit_one_step
from hydro_twin.studies.b19.study import make_part, model_of


def network_models(
    train: Recording, plant: Plant, constants: Mapping[str, float], seed: int,
) -> dict[str, Model]:
    """Make what the MLP and the hybrid are trained for; the hybrid is on least squares."""
    factor = make_part('training', train, plant).factor
    best = fit_one_step('least_squares', factor,
                        coefficients_of(plant, constants, train.sample_time), plant, seed).best
    return {'mlp': Model(plant, constants, train.sample_time, kind='mlp'),
            'hybrid': model_of('hybrid', best, plant, constants, train.sample_time)}


def searches(
    train: Recording, plant: Plant, constants: Mapping[str, float], log: Path, seed: int,
    device: str, trial_done: Callable[[], object],
) -> dict[str, list[Round]]:
    """Search the settings of MLP and hybrid; the arguments are those of `chosen_settings`."""
    return {kind: search(network_problem(train, model), SETTINGS[kind],
                         Path(str(log).format(kind)), seed, device, trial_done=trial_done)
            for kind, model in network_models(train, plant, constants, seed).items()}


def chosen_settings(
    train: Recording, plant: Plant, constants: Mapping[str, float], log: Path, seed: int,
    device: str, trial_done: Callable[[], object],
) -> dict[str, Settings]:
    """Choose the settings of MLP and hybrid on a third of the training patterns.

    Args:
        train: what is fitted; it is all that is looked at.
        plant: the plant, at the sample time of the recording.
        constants: of the rig.
        log: file of the trials, with {} for the kind of network.
        seed: of the splits and the weights.
        device: as in `network.train_many`.
        trial_done: called after every network.
    """
    found = searches(train, plant, constants, log, seed, device, trial_done)
    return {kind: rounds[-1].chosen for kind, rounds in found.items()}
