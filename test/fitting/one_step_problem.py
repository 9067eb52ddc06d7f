"""Data for the tests of the one-step fit, made by the difference equation itself."""
import numpy as np
from scipy.signal import lfilter

from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.plants.load_simulator_eq1 import coefficients
from hydro_twin.recording.series import Series

NAMES = [p.name for p in LOAD_SIMULATOR.parameters]
LOWER = np.array([p.lower for p in LOAD_SIMULATOR.parameters])
UPPER = np.array([p.upper for p in LOAD_SIMULATOR.parameters])
COMBINATIONS = LOAD_SIMULATOR.combinations
SIGNALS = 'T_g', ('u_m', 'theta_d'), 4


def eq1(parameters):
    return coefficients(parameters, {'D_m': 2e-5}, 0.002)


def recording(parameters, rng, noise=0.0, friction=0.0, samples=1000):
    """Three stretches at 1, 7 and 9 Hz, with white noise in the equation."""
    t = 0.002 * np.arange(samples)
    c = eq1(parameters[None])[0]
    stretches = []
    for hertz in (1.0, 7.0, 9.0):
        u = 0.5 * np.sin(2 * np.pi * hertz * t) + 0.1 * rng.standard_normal(samples)
        theta = (0.03 * np.sin(2 * np.pi * hertz * t + rng.uniform(0.0, 6.0))
                 + 1e-5 * np.cumsum(rng.standard_normal(samples)))
        drive = (np.convolve(u, c[4:9])[:samples] + np.convolve(theta, c[9:])[:samples]
                 + noise * rng.standard_normal(samples))
        torque = lfilter([1.0], np.append(1.0, -c[:4]), drive)
        torque += friction * np.sign(np.gradient(theta))
        stretches.append(Series({'T_g': torque, 'u_m': u, 'theta_d': theta}, 0.002))
    return stretches
