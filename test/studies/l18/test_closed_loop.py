"""The closed loop against a continuous integrator, and at rest."""
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydro_twin.errors import DataError
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.studies.l18.closed_loop import agreement, run_loop
from hydro_twin.studies.l18.event import CONSTANTS
from hydro_twin.studies.l18.flow_characteristic import default_characteristic, FlowCharacteristic
from hydro_twin.studies.l18.limit import with_limit
from hydro_twin.studies.l18.linear_loop import PUBLISHED
from hydro_twin.studies.l18.power_control import power_asked
from hydro_twin.studies.l18.servo_model import published, without_nonlinear_factors

V = {constant.name: constant.value for constant in CONSTANTS}
T = 0.002


@pytest.fixture
def curve() -> FlowCharacteristic:
    return default_characteristic()


def test_rest_stays_rest(curve: FlowCharacteristic) -> None:
    run = run_loop(Analytical(published()), curve, np.full(2000, 50.0), 0.8, V)
    assert run.power == pytest.approx(np.full(2000, 0.8), abs=1e-9)
    assert run.opening == pytest.approx(np.full(2000, curve.inverse(0.8)), abs=1e-9)


def test_equals_an_integrator_of_the_whole_loop(curve: FlowCharacteristic) -> None:
    T_y, T_c, tau, k_1 = PUBLISHED
    frequency = 49.9
    asked = power_asked(frequency, 0.8, V)

    def laws(_: float, x: np.ndarray) -> list[float]:
        c, a, y, hp, ip, lp, integral, slow = x
        power = V['F_HP'] * hp + V['F_IP'] * ip + V['F_LP'] * lp
        rate = (power - slow) / V['T_D']
        command = integral + V['K_P'] * (asked - power) - V['K_D'] * rate
        return [(k_1 * (command - y) - c) / T_y, c / T_c, (a - y) / tau,
                (float(curve(y)) - hp) / V['T_CH'], (hp - ip) / V['T_RH'], (ip - lp) / V['T_CO'],
                V['K_I'] * (asked - power), rate]

    opening = curve.inverse(0.8)
    start = [0, opening, opening, 0.8, 0.8, 0.8, opening, 0.8]
    time = T * np.arange(5000)
    x = solve_ivp(laws, (0, time[-1]), start, t_eval=time, method='LSODA', rtol=1e-8,
                  atol=1e-10).y
    course = np.full(len(time), frequency)
    course[0] = 50.0
    run = run_loop(Analytical(published()), curve, course, 0.8, V)
    power = V['F_HP'] * x[3] + V['F_IP'] * x[4] + V['F_LP'] * x[5]
    assert np.ptp(power) > 0.02
    assert run.opening == pytest.approx(x[2], abs=2e-4)      # of a loop sampled at 2 ms
    assert run.power == pytest.approx(power, abs=2e-5)


def test_the_limit_of_the_curve_holds_the_valve(curve: FlowCharacteristic) -> None:
    limited = with_limit(published(), curve)
    course = np.full(20_000, 49.5)
    course[0] = 50.0
    more = {**V, 'amplitude': 0.3}                  # for which the curve has no flow
    run = run_loop(Analytical(limited), curve, course, 0.95, more)
    free = run_loop(Analytical(replace(limited, effects=())), curve, course, 0.95, more)
    assert run.opening.max() == pytest.approx(curve.d_1)
    assert free.opening.max() == pytest.approx(V['u_max'], abs=1e-3)
    errors = agreement(run.opening, free.opening)
    assert errors['steady_error_percent'] == pytest.approx(
        100 * (V['u_max'] - curve.d_1), abs=0.1)
    assert errors['relative_error_percent'] == pytest.approx(
        100 * (V['u_max'] / curve.d_1 - 1), abs=0.1)


@pytest.mark.slow
def test_below_the_limit_the_nonlinear_factors_are_not_seen_at_rest(
        curve: FlowCharacteristic) -> None:
    """Y/U = 1 at rest for every k_1, T_c, T_y and tau, and the PID has an integral."""
    servo = with_limit(published(), curve)
    course = np.full(20_000, 49.5)
    course[0] = 50.0
    runs = [run_loop(Analytical(model), curve, course, 0.85, V)
            for model in (servo, without_nonlinear_factors(servo))]
    assert runs[0].power[-1] == pytest.approx(0.85 + V['amplitude'], abs=2e-3)
    assert runs[1].opening[-1] == pytest.approx(runs[0].opening[-1], abs=1e-4)


def test_a_load_that_the_curve_does_not_reach_is_refused(curve: FlowCharacteristic) -> None:
    with pytest.raises(DataError, match='does not reach the power'):
        run_loop(Analytical(published()), curve, np.full(10, 50.0), 1.2, V)


def test_agreement_is_as_defined() -> None:
    measured = np.array([0.0, 1.0, 2.0, 3.0])
    assert agreement(measured, measured)['fit_percent'] == 100
    assert agreement(measured, np.full(4, 1.5))['fit_percent'] == pytest.approx(0)
    assert agreement(measured, measured + 0.1)['steady_error_percent'] == pytest.approx(10)


def test_d_1_of_a_model_is_kept(curve: FlowCharacteristic, tmp_path: Path) -> None:
    once = with_limit(published(), curve)
    assert with_limit(once, FlowCharacteristic(curve.opening * 1.1, curve.flow)) is once
