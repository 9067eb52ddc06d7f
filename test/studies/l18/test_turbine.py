"""The reheat turbine against scipy's step response of its transfer function."""
import numpy as np
import pytest
from scipy.signal import lti, step

from hydro_twin.studies.l18.turbine import CONSTANTS, Turbine


def test_step_of_the_flow_equals_the_transfer_function() -> None:
    v = {constant.name: constant.value for constant in CONSTANTS}
    chest, reheater, crossover = ([v[name], 1.0] for name in ('T_CH', 'T_RH', 'T_CO'))
    numerator = np.polyadd(
        v['F_HP'] * np.polymul(reheater, crossover),
        np.polyadd(v['F_IP'] * np.array(crossover), [v['F_LP']]))
    time = 0.02 * np.arange(1000)
    _, expected = step(lti(numerator, np.polymul(np.polymul(chest, reheater), crossover)), T=time)
    turbine = Turbine(v, 0.02, flow=0.0)
    power = []
    for _ in time:
        power.append(turbine.power)
        turbine.step(1.0)
    assert power == pytest.approx(expected, abs=1e-9)


def test_the_shares_are_of_all_the_power() -> None:
    assert sum(c.value for c in CONSTANTS if c.name.startswith('F_')) == pytest.approx(1.0)
