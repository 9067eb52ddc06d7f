"""Droop against its definition, and the PID at its limit."""
import pytest

from hydro_twin.studies.l18.power_control import CONSTANTS, power_asked, PowerControl

V = {constant.name: constant.value for constant in CONSTANTS}


def test_droop_asks_for_all_the_power_at_its_share_of_the_frequency() -> None:
    full = V['droop'] * V['f_n'] + V['dead_band']
    free = {**V, 'amplitude': 2.0}
    assert power_asked(V['f_n'] - full, 0.5, free) == pytest.approx(1.5)
    assert power_asked(V['f_n'] + full, 0.5, free) == pytest.approx(-0.5)


def test_frequency_asks_for_no_more_than_the_amplitude() -> None:
    """From 890 MW of 1000 to the 950 of [L18] figure 13."""
    assert power_asked(V['f_n'] - 0.2, 0.89, V) == pytest.approx(0.95)
    assert power_asked(V['f_n'] + 5.0, 0.89, V) == pytest.approx(0.83)


def test_the_dead_band_asks_for_nothing() -> None:
    for sign in (-1, 1):
        assert power_asked(V['f_n'] + sign * 0.99 * V['dead_band'], 0.7, V) == 0.7


def test_it_stays_at_rest() -> None:
    control = PowerControl(V, 0.01, command=0.8, power=0.9)
    assert [control.step(0.9, 0.9) for _ in range(10)] == pytest.approx([0.8] * 10)


def test_its_integral_does_not_wind_up() -> None:
    control = PowerControl(V, 0.01, command=1.0, power=0.9)
    for _ in range(100_000):
        held = control.step(1.5, 0.9)
    assert held == V['u_max']
    assert control.step(0.9, 0.9) < V['u_max']


def test_it_integrates_a_constant_error() -> None:
    values = {**V, 'K_P': 0.0, 'K_D': 0.0}
    control = PowerControl(values, 0.01, command=0.5, power=0.5)
    for _ in range(100):
        command = control.step(0.6, 0.5)
    assert command == pytest.approx(0.5 + V['K_I'] * 0.1 * 1.0)
