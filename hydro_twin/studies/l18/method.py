"""The published network method as a method of `hydro-twin refit` for the valve servo."""
from __future__ import annotations

from hydro_twin.errors import DataError, UserError
from hydro_twin.fitting.physics import as_known, Method, Physics, Task
from hydro_twin.model import Uncertainty
from hydro_twin.plants.valve_servo import VALVE_SERVO
from hydro_twin.studies.l18.direct import NAMES
from hydro_twin.studies.l18.linear_loop import PUBLISHED
from hydro_twin.studies.l18.published_method import fit_published


def fit_network(task: Task) -> Physics:
    """Fit the valve servo by the network of [L18], its weights read as the nearest loop.

    k_1 is held, at the published value if at no other. A lag that stopped at the edge of its
    search box is not identifiable.

    Raises:
        UserError: the plant is another, or another parameter than k_1 is to be held.
        DataError: the recording does not allow it, or the weights are of no servo.
    """
    plant, held = task.plant, task.held
    if plant.name != VALVE_SERVO.name:
        raise UserError(f'--method network is that of [L18] for the {VALVE_SERVO.name}, '
                        f'not for {plant.name}')
    if others := sorted(set(held) - {'k_1'}):
        raise UserError(f'--method network fits {", ".join(NAMES)} together: it cannot hold '
                        f'{", ".join(others)}, only k_1')
    k_1 = held.get('k_1', PUBLISHED.k_1)
    found = fit_published(task.train, k_1, task.seed).nearest
    if 'T_c' in found.at_edge:
        raise DataError('the weights of the network are of no servo: the nearest has T_c/k_1 '
                        f'{found.parameters.T_c / k_1:.3g} s, the edge of the search box; '
                        '--method least_squares fits the parameters themselves')
    return Physics(
        {**{name: getattr(found.parameters, name) for name in NAMES}, 'k_1': k_1},
        {name: Uncertainty(identifiable=name not in found.at_edge) for name in NAMES}
        | as_known(['k_1']), None)


NETWORK = Method('network', fit_network)
