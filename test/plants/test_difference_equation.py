import numpy as np
import pytest
from scipy import signal

from hydro_twin.plants import PLANTS
from hydro_twin.plants.difference_equation import bilinear, from_state_space

VECTOR = {'V_m': 1.75e-4, 'J': 5.5e-2, 'K_p': 1.75e-2, 'K_q': 1.35, 'G': 1.1e4, 'K_ce': 5.5e-12,
          'B_m': 55.0, 'K_sv': 1.15e-4, 'beta_e': 7e8, 'D_m': 2e-5}


def test_eq_1_from_the_state_space_form_is_the_test_vector_of_fifty_digits():
    equation = bilinear(PLANTS['load_simulator'].laws(VECTOR), 0.002)
    f = [-2.3384612011176684, 1.9118802390707814, -0.673517397787217, 0.10616283877758148]
    d = 0.21397962635792955 * np.array([1, 4, 6, 4, 1])
    e = [-10046.360686138154, 25980.434537458183, -22663.922615243893, 7184.684684684685,
         -454.83592076081646]
    np.testing.assert_allclose(equation.a, f, rtol=1e-9)
    np.testing.assert_allclose(equation.b[:, 0], d, rtol=1e-9)
    np.testing.assert_allclose(equation.b[:, 1], e, rtol=1e-9)


@pytest.mark.parametrize('plant', PLANTS.values(), ids=PLANTS)
def test_responds_as_the_continuous_laws_at_the_warped_frequency(plant):
    values = {p.name: (p.lower * p.upper) ** 0.5 for p in plant.parameters}
    laws = plant.laws(values | plant.constant_values())
    T = plant.sample_time
    equation = bilinear(laws, T)
    for z in np.exp(2j * np.pi * np.array([0.001, 0.014, 0.12, 0.4])):
        s = 2 / T * (z - 1) / (z + 1)
        expected = laws.C @ np.linalg.solve(s * np.eye(plant.order) - laws.A, laws.B) + laws.D
        lags = z ** -np.arange(plant.order + 1.0)
        found = lags @ equation.b / (lags @ [1.0, *equation.a])
        np.testing.assert_allclose(found, expected[0], rtol=1e-6)


def test_eliminates_the_states():
    Phi, Gamma = np.array([[0.5, 0.1], [0.0, 0.8]]), np.array([[1.0], [2.0]])
    C, D = np.array([[1.0, 3.0]]), np.array([[0.5]])
    equation = from_state_space(Phi, Gamma, C, D)
    num, den = signal.ss2tf(Phi, Gamma, C, D)
    np.testing.assert_allclose([1.0, *equation.a], den)
    np.testing.assert_allclose(equation.b[:, 0], num[0])
