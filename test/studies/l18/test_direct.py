"""Least squares on the physical parameters, on data of an independent integrator."""
import numpy as np
import pytest

from hydro_twin.errors import DataError
from hydro_twin.recording.series import Recording, Series
from hydro_twin.simulation.sensor import measure
from hydro_twin.studies.l18.demonstration import simulated_steps, STEPS
from hydro_twin.studies.l18.direct import fit_free_run, fit_one_step, NAMES
from hydro_twin.studies.l18.flow_characteristic import default_characteristic
from hydro_twin.studies.l18.linear_loop import LoopParameters, PUBLISHED
from hydro_twin.studies.l18.published_method import fit_published


@pytest.fixture(scope='module')
def clean() -> Series:
    return simulated_steps(STEPS, default_characteristic())


def noisy(series: Series, noise: float) -> Recording:
    return Recording((measure(series, 'opening', None, noise, 0.0,
                              np.random.default_rng(7))[0],))


@pytest.mark.parametrize('fit', [fit_free_run, fit_one_step])
def test_without_noise_the_truth_is_found(clean: Series, fit) -> None:
    found = fit(Recording((clean,)), PUBLISHED.k_1)
    for name in NAMES:
        assert found[name].value == pytest.approx(getattr(PUBLISHED, name), rel=1e-4)


def test_the_network_agrees_without_noise(clean: Series) -> None:
    recording = Recording((clean,))
    direct = fit_free_run(recording, PUBLISHED.k_1)
    network = fit_published(recording, PUBLISHED.k_1).exact
    assert isinstance(network, LoopParameters)
    assert network.T_c == pytest.approx(direct['T_c'].value, rel=0.002)
    assert network.T_y == pytest.approx(direct['T_y'].value, rel=0.01)


def test_with_noise_the_truth_is_within_the_error_of_the_free_run(clean: Series) -> None:
    found = fit_free_run(noisy(clean, 1e-3), PUBLISHED.k_1)
    for name in NAMES:
        assert found[name].identifiable
        distance = abs(found[name].value - getattr(PUBLISHED, name))
        assert 0 < distance < 4 * found[name].std_error
    assert found['T_y'].std_error < 0.05 * PUBLISHED.T_y


def test_one_step_says_what_noise_hides(clean: Series) -> None:
    assert not fit_one_step(noisy(clean, 1e-3), PUBLISHED.k_1)['tau'].identifiable


def test_another_k_1_scales_T_c_alone(clean: Series) -> None:  # noqa: N802
    for fit in (fit_free_run, fit_one_step):
        one, two = (fit(Recording((clean,)), k_1) for k_1 in (0.8, 1.6))
        assert two['T_c'].value == pytest.approx(2 * one['T_c'].value, rel=1e-4)
        assert two['T_y'].value == pytest.approx(one['T_y'].value, rel=1e-3)


def test_a_command_that_rests_is_refused() -> None:
    still = Recording((Series({'command': np.ones(500), 'opening': np.ones(500)}, 0.002),))
    with pytest.raises(DataError, match='never moves'):
        fit_one_step(still, 1.0)
    with pytest.raises(DataError, match='never moves'):
        fit_free_run(still, 1.0)
