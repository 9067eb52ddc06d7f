"""The exact discretisation against printed numbers, scipy and an independent integrator."""
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, lfilter, step

from hydro_twin.errors import DataError
from hydro_twin.studies.l18.linear_loop import (
    exact_equivalent,
    LoopParameters,
    parameters_from_poles,
    PUBLISHED,
    Weights,
)
from hydro_twin.studies.l18.printed_equation import printed_weights

TABLE_1 = Weights((7.98e-5, 8.01e-5), (1.96, -0.962, 0.00255))     # [L18]


def random_loop(rng: np.random.Generator) -> LoopParameters:
    return LoopParameters(T_y=rng.uniform(0.01, 0.03), T_c=rng.uniform(0.1, 0.5),
                          tau=rng.uniform(1e-3, 9e-3), k_1=rng.uniform(0.5, 2.0))


def test_published_values_give_the_known_coefficients() -> None:
    weights = exact_equivalent(*PUBLISHED, T=0.001)
    assert weights.v == pytest.approx([9.46706538e-6, 3.44161353e-5, 7.78820463e-6], rel=1e-6)
    assert weights.n == pytest.approx([2.66275286, -2.3394837, 0.67667917], rel=1e-6)
    assert weights.gain() == pytest.approx(1, abs=1e-8)


def test_equals_scipy_on_the_transfer_function() -> None:
    rng = np.random.default_rng(1)
    for _ in range(100):
        T_y, T_c, tau, k_1 = loop = random_loop(rng)
        T = rng.uniform(5e-4, 2e-2)
        closed = ([k_1], [T_c * T_y * tau, T_c * (T_y + tau), T_c, k_1])
        b, a, _ = cont2discrete(closed, T)
        weights = exact_equivalent(*loop, T)
        assert weights.v == pytest.approx(b[0, 1:], rel=1e-6, abs=1e-12)
        assert weights.n == pytest.approx(-a[1:], rel=1e-6, abs=1e-12)


def test_step_response_equals_an_integrator_of_the_laws() -> None:
    T_y, T_c, tau, k_1 = PUBLISHED

    def laws(_: float, x: np.ndarray) -> list[float]:
        converter, actuator, opening = x
        return [(k_1 * (1 - opening) - converter) / T_y, converter / T_c,
                (actuator - opening) / tau]

    T = 0.005
    time = T * np.arange(200)
    opening = solve_ivp(laws, (0, time[-1]), np.zeros(3), t_eval=time, rtol=1e-10, atol=1e-12).y[2]
    v, n = exact_equivalent(*PUBLISHED, T)
    ours = lfilter([0, *v], [1, *(-weight for weight in n)], np.ones(200))
    assert ours == pytest.approx(opening, abs=1e-8)


def test_poles_give_the_parameters_back() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        loop = random_loop(rng)
        back = parameters_from_poles(exact_equivalent(*loop, T=0.002), 0.002, loop.k_1)
        # T_y and tau may be exchanged, and their difference is ill conditioned where they meet
        assert back.T_c == pytest.approx(loop.T_c, rel=1e-6)
        assert back.T_y == pytest.approx(max(loop.T_y, loop.tau), rel=1e-3)
        assert back.tau == pytest.approx(min(loop.T_y, loop.tau), rel=1e-3)


def test_only_the_ratio_of_time_and_gain_acts() -> None:
    T_y, T_c, tau, k_1 = PUBLISHED
    ours, doubled = (exact_equivalent(T_y, c * T_c, tau, c * k_1, 0.001) for c in (1, 2))
    assert doubled.n == pytest.approx(ours.n, rel=1e-9)
    assert doubled.v == pytest.approx(ours.v, rel=1e-6)


def test_table_1_as_printed_is_unstable() -> None:
    assert TABLE_1.poles().real == pytest.approx([1.0104, 0.9469, 0.0027], abs=5e-5)
    assert TABLE_1.gain() == pytest.approx(-0.29, abs=0.005)
    with pytest.raises(DataError, match='not stable'):
        parameters_from_poles(TABLE_1, 0.001, PUBLISHED.k_1)


def test_the_printed_equation_holds_no_tau_and_a_step_does_not_show_it() -> None:
    T, printed = 0.001, printed_weights(*PUBLISHED, 0.001)
    assert printed.poles().real == pytest.approx([0.99590, 0.96097, 0.00267], abs=5e-6)
    assert -T / np.log(printed.poles().real) == pytest.approx(
        [0.2434, 0.0251, 0.00017], rel=1e-2)
    T_y, T_c, tau, k_1 = PUBLISHED
    closed = [T_c * T_y * tau, T_c * (T_y + tau), T_c, k_1]
    assert max(-1 / np.roots(closed).real) == pytest.approx(0.2436, abs=5e-5)
    time, true = step(([k_1], closed), T=T * np.arange(3000))
    found = lfilter([0, *printed.v], [1, *(-n for n in printed.n)], np.ones(len(time)))
    assert np.abs(found - true).max() == pytest.approx(0.0042, abs=5e-5)


@pytest.mark.parametrize(('poles', 'says'), [
    ((1.01, 0.9, 0.5), 'not stable'),
    ((0.99, 0.9, -0.6), 'must be positive'),
    ((0.99, 0.98, 0.97), 'no real positive'),
])
def test_poles_of_no_servo_are_refused(poles: tuple[float, ...], says: str) -> None:
    n1, n2, n3 = -np.poly(poles)[1:]
    with pytest.raises(DataError, match=says):
        parameters_from_poles(Weights((0.0, 0.0), (n1, n2, n3)), 0.001, 1.0)


def test_a_lag_too_fast_for_the_sampling_is_not_told() -> None:
    n1, n2, n3 = -np.poly([0.95, 0.6, -0.01])[1:]
    read = parameters_from_poles(Weights((0.0, 0.0), (n1, n2, n3)), 0.01, 1.0)
    t_1, t_2 = -0.01 / np.log([0.95, 0.6])
    assert np.isnan(read.tau)
    assert read.T_c == pytest.approx(t_1 + t_2)
    assert read.T_y == pytest.approx(t_1 * t_2 / (t_1 + t_2))
