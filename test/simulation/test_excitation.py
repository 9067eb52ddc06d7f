import numpy as np
import pytest
from scipy import signal

from hydro_twin.errors import UserError
from hydro_twin.plants import PLANTS
from hydro_twin.simulation.excitation import KINDS, make, parse, Run

PLANT = PLANTS['load_simulator']
LAWS = PLANT.laws({p.name: (p.lower * p.upper) ** 0.5 for p in PLANT.parameters}
                  | PLANT.constant_values())
T = 0.002 * np.arange(5000)


def made(text, seed=0):
    return make(parse(text), Run(10.0, np.random.default_rng(seed)), LAWS, 0, 100.0, 0.002)


@pytest.mark.parametrize('kind', KINDS)
def test_starts_at_zero_reaches_its_amplitude_and_repeats_with_its_seed(kind):
    u = made(f'{kind}:amplitude=0.7')(T)
    assert u[0] == 0.0
    assert 0.5 < np.abs(u).max() <= 0.7 * (1 + 1e-6)
    np.testing.assert_array_equal(u, made(f'{kind}:amplitude=0.7')(T))
    # A function of time, whatever it is asked for at once.
    np.testing.assert_allclose(made(f'{kind}:amplitude=0.7')(T[1000:1003]), u[1000:1003])


@pytest.mark.parametrize('kind', ['multisine', 'steps', 'random'])
def test_another_seed_is_another_signal(kind):
    assert np.abs(made(f'{kind}:amplitude=1')(T) - made(f'{kind}:amplitude=1', 1)(T)).max() > 0.1


def power(text):
    f, p = signal.welch(made(text)(T), 500.0, nperseg=2048)
    return f, p / p.sum()


def test_sine_has_its_frequency():
    f, p = power('sine:frequency=7,amplitude=1')
    assert f[p.argmax()] == pytest.approx(7.0, abs=0.25)


def test_multisine_and_random_stay_in_their_band():
    f, p = power('multisine:lowest=2,highest=6,amplitude=1')
    assert p[(f > 1.5) & (f < 6.5)].sum() > 0.97
    f, p = power('random:bandwidth=3,amplitude=1')
    assert p[f < 6.0].sum() > 0.95


def test_chirp_sweeps_between_its_frequencies():
    phase = np.unwrap(np.angle(signal.hilbert(made('chirp:first=2,last=20,amplitude=1')(T))))
    frequency = np.gradient(phase, 0.002) / 2 / np.pi
    assert np.median(frequency[200:500]) == pytest.approx(2 * 10 ** 0.07, rel=0.1)
    assert np.median(frequency[4500:4800]) == pytest.approx(2 * 10 ** 0.93, rel=0.1)


def test_without_amplitude_the_linear_plant_reaches_the_range():
    u = made('sine:frequency=7')(T)
    y = signal.lsim((LAWS.A, LAWS.B[:, [0]], LAWS.C, LAWS.D[:, [0]]), u, T)[1]
    assert np.abs(y).max() == pytest.approx(100.0, rel=0.01)


def test_offset_is_added():
    assert made('sine:amplitude=1,offset=2')(np.zeros(1))[0] == 2.0


@pytest.mark.parametrize(('text', 'says'), [
    ('noise', "no excitation 'noise'; there are sine, multisine, chirp, steps, random"),
    ('sine:phase=1', 'sine has no phase; it has frequency, amplitude, offset'),
    ('sine:frequency', 'NAME=NUMBER'),
    ('sine:frequency=fast', 'NAME=NUMBER'),
    ('sine:frequency=0', 'frequency must be above zero'),
    ('sine:frequency=nan', 'must be finite'),
    ('sine:amplitude=inf', 'must be finite'),
    ('steps:shortest=1', 'shortest, 1, must not be above longest, 0.5'),
    ('multisine:lowest=20', 'lowest, 20, must not be above highest, 10'),
    ('multisine:lines=0.5', 'lines must be 1 at least'),
])
def test_what_is_not_an_excitation_is_refused(text, says):
    with pytest.raises(UserError, match=says):
        parse(text)


def test_a_chirp_between_equal_frequencies_is_a_sine():
    np.testing.assert_allclose(made('chirp:first=3,last=3,amplitude=1')(T),
                               np.sin(2 * np.pi * 3 * T), atol=1e-12)


def test_a_sine_that_is_zero_at_every_sample_is_refused():
    with pytest.raises(UserError, match=r'samples 0\.002 s apart'):
        made('sine:frequency=500')
