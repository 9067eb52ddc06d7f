import numpy as np
import pytest
from scipy import signal

from hydro_twin.plants import PLANTS
from hydro_twin.plants.load_simulator_eq1 import coefficients

D_M, T = 2e-5, 0.002
BOX = PLANTS['load_simulator'].parameters
NAMES = [p.name for p in BOX]


def draws(seed):
    rng = np.random.default_rng(seed)
    return rng.uniform([p.lower for p in BOX], [p.upper for p in BOX], (40, 9))


def test_agrees_with_the_test_vector_of_fifty_digits():
    f1, f2, f3, f4 = (-2.3384612011176684, -1.9118802390707814, 0.673517397787217,
                      0.10616283877758148)
    d0 = 0.21397962635792955
    e = [10046.360686138154, -25980.434537458183, -22663.922615243893, 7184.684684684685,
         454.83592076081646]
    expected = [-f1, f2, f3, -f4, d0, 4 * d0, 6 * d0, 4 * d0, d0,
                -e[0], -e[1], e[2], e[3], -e[4]]
    parameters = np.array([[1.75e-4, 5.5e-2, 1.75e-2, 1.35, 1.1e4, 5.5e-12, 55, 1.15e-4, 7e8]])
    np.testing.assert_allclose(coefficients(parameters, {'D_m': D_M}, T)[0], expected, rtol=1e-12)


def test_is_the_bilinear_transform_of_the_printed_transfer_function():
    population = draws(1)
    found = coefficients(population, {'D_m': D_M}, T)
    for row, (V_m, J, K_p, K_q, G, K_ce, B_m, K_sv, beta_e) in zip(
            found, population, strict=True):
        den = 4 * beta_e * D_M * K_q * G                        # [B19] eqs 17 to 20
        a1 = V_m * J * K_p / den
        a2 = (4 * beta_e * K_p * K_ce * J + V_m * (K_p * B_m + J)) / den
        a3 = (4 * beta_e * (K_p * D_M**2 + K_ce * (K_p * B_m + J))
              + V_m * (K_p * G + B_m)) / den
        a4 = (4 * beta_e * (G * K_p * K_ce + D_M**2 + K_ce * B_m) + G * V_m) / den
        a5 = K_ce / (D_M * K_q)
        b1 = (4 * beta_e * (K_p * D_M**2 + K_ce * (K_p * B_m + J)) + V_m * B_m) * G / den
        b2 = (D_M**2 + K_ce * B_m) / (D_M * K_q)
        past = [a1, a2, a3, a4, a5]
        d, a = signal.bilinear([K_sv], past, 1 / T)
        e, _ = signal.bilinear([-G * a1, -G * a2, -b1, -b2, 0.0], past, 1 / T)
        np.testing.assert_allclose(row[:4], -a[1:], rtol=1e-9)
        np.testing.assert_allclose(row[4:9], d, rtol=1e-9)
        np.testing.assert_allclose(row[9:], e, rtol=1e-9)


def test_is_the_bilinear_transform_of_the_five_laws():
    population = draws(2)
    found = coefficients(population, {'D_m': D_M}, T)
    z = np.exp(1j * 2 * np.pi * np.array([0.5, 7.0, 60.0, 200.0]) * T)
    s = 2 / T * (z - 1) / (z + 1)
    powers = z[:, None] ** -np.arange(5.0)
    for row, values in zip(found, population, strict=True):
        laws = PLANTS['load_simulator'].laws({**dict(zip(NAMES, values, strict=True)), 'D_m': D_M})
        response = [(laws.C @ np.linalg.solve(si * np.eye(4) - laws.A, laws.B) + laws.D)[0]
                    for si in s]
        past = 1 - powers[:, 1:] @ row[:4]
        expected = np.stack((powers @ row[4:9], powers @ row[9:]), axis=1) / past[:, None]
        np.testing.assert_allclose(response, expected, rtol=1e-7)


@pytest.mark.parametrize('row', [0, 17, 39])
def test_a_candidate_does_not_depend_on_its_population(row):
    population = draws(3)
    np.testing.assert_allclose(coefficients(population[row:row + 1], {'D_m': D_M}, T)[0],
                               coefficients(population, {'D_m': D_M}, T)[row], rtol=1e-14)
