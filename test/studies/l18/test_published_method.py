"""The method of [L18] on data of an independent integrator, and its figures."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.special import expit

from hydro_twin.errors import DataError
from hydro_twin.recording.series import Recording, Series
from hydro_twin.studies.l18.figures import residual_figures
from hydro_twin.studies.l18.linear_loop import LoopParameters, PUBLISHED
from hydro_twin.studies.l18.published_method import (
    fit_published,
    predict_rivals,
    prepare,
    PublishedFit,
)

T = 0.005
LEVELS = (0.3, 0.3, 0.6, 0.4, 0.8, 0.5, 0.5, 0.5)       # each held for 0.75 s, rest at both ends


def steps_recording(noise: float = 0.0) -> Recording:
    T_y, T_c, tau, k_1 = PUBLISHED
    samples = 150
    opening, state = [], np.array([0.0, LEVELS[0], LEVELS[0]])
    for level in LEVELS:
        def laws(_: float, x: np.ndarray, level: float = level) -> list[float]:
            return [(k_1 * (level - x[2]) - x[0]) / T_y, x[0] / T_c, (x[1] - x[2]) / tau]

        time = T * np.arange(samples + 1)
        x = solve_ivp(laws, (0, time[-1]), state, t_eval=time, rtol=1e-11, atol=1e-13,
                      method='DOP853').y
        opening.append(x[2, :-1])
        state = x[:, -1]
    y = np.concatenate(opening)
    y = y + noise * np.random.default_rng(3).standard_normal(len(y))
    return Recording((Series({'command': np.repeat(LEVELS, samples), 'opening': y}, T),))


@pytest.fixture(scope='module')
def clean() -> PublishedFit:
    return fit_published(steps_recording(), k_1=PUBLISHED.k_1)


def test_without_noise_the_weights_hold_the_parameters(clean: PublishedFit) -> None:
    assert isinstance(clean.exact, LoopParameters)
    assert clean.exact.T_c == pytest.approx(PUBLISHED.T_c, rel=0.01)
    assert clean.exact.T_y == pytest.approx(PUBLISHED.T_y, rel=0.02)
    assert clean.weights.gain() == pytest.approx(1, abs=1e-4)


def test_the_printed_mapping_fails_on_a_true_servo(clean: PublishedFit) -> None:
    assert isinstance(clean.printed, str)
    assert 'no real positive' in clean.printed


def test_the_rbf_net_fits_and_does_not_predict(clean: PublishedFit) -> None:
    errors = clean.errors(predict_rivals(clean.data))
    assert errors['rbf']['train'] < 1e-5
    assert errors['rbf']['test'] > 1000 * errors['rbf']['train']
    assert errors['5-1-1']['train'] < errors['rbf']['train']        # opposite to the paper
    assert errors['5-1-1']['test'] < 1e-6
    assert errors['5-1-1 free run']['test'] < 1e-4


def test_the_output_layer_of_eq_9_is_the_identity(clean: PublishedFit) -> None:
    """Without noise w21, b12 and b21, trained too, come back to 1, 0 and 0, wherever they start.

    The target is the logistic of the opening, so that these values leave no error; and no others
    do, since no logistic is another one scaled and shifted.
    """
    X, y = clean.data.regressors[:clean.data.train], clean.data.target[:clean.data.train]
    w = np.array([*clean.weights.v, *clean.weights.n])

    def error(x: np.ndarray) -> np.ndarray:
        scale, output_scale, hidden_bias, output_bias = x
        return output_scale * expit(scale * X @ w + hidden_bias) + output_bias - expit(y)

    for start in ([0.8, 1.3, 0.2, -0.2], [1.2, 0.7, -0.3, 0.1]):
        fit = least_squares(error, start, x_scale='jac', xtol=1e-15, ftol=1e-15, gtol=1e-15)
        assert fit.x == pytest.approx([1, 1, 0, 0], abs=1e-3)


def test_noise_of_a_plant_takes_the_lags_away() -> None:
    fit = fit_published(steps_recording(noise=1e-3), k_1=PUBLISHED.k_1)
    assert residual_figures(fit)['fit'] > 0.99          # as published, and yet:
    assert isinstance(fit.exact, str) or fit.exact.T_y != pytest.approx(PUBLISHED.T_y, rel=0.5)


def test_the_nearest_loop_survives_the_noise_that_the_poles_do_not() -> None:
    fit = fit_published(steps_recording(noise=5e-4), k_1=PUBLISHED.k_1)
    assert isinstance(fit.exact, str)
    assert fit.nearest.at_edge == ()
    assert fit.nearest.parameters.T_c == pytest.approx(PUBLISHED.T_c, rel=0.01)
    assert fit.nearest.parameters.T_y == pytest.approx(PUBLISHED.T_y, rel=0.2)


def test_one_seed_gives_one_result(clean: PublishedFit) -> None:
    assert fit_published(steps_recording(), PUBLISHED.k_1).weights == clean.weights


def test_the_window_is_scaled_as_one(clean: PublishedFit) -> None:
    data = prepare(steps_recording())
    assert data.regressors.shape == (697, 5)
    assert data.train == 597
    assert data.target[:data.train].min() >= 0
    assert data.regressors[:data.train].max() <= 1
    assert clean.data.opening == pytest.approx(data.raw, abs=0.1)       # but for the filter


@pytest.mark.parametrize(('recording', 'says'), [
    (Recording((steps_recording().series[0].part(0, 500),)), 'takes 700 samples .* has 500'),
    (Recording(()), 'longest has 0'),
    (Recording((Series({'command': np.ones(800), 'opening': np.ones(800)}, T),)), 'not move'),
    (Recording((Series({'command': np.arange(800.), 'opening': np.arange(800.)}, 0.1),)),
     'needs more than 40'),
])
def test_data_that_do_not_allow_it_are_refused(recording: Recording, says: str) -> None:
    with pytest.raises(DataError, match=says):
        fit_published(recording, 1.0)
