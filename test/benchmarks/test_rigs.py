import numpy as np
import pytest
from scipy.signal import lsim

from benchmarks.tracing.draws import Command, Scales, Sensor
from benchmarks.tracing.lacking import LAWS
from benchmarks.tracing.laws import integrate, Laws, SAMPLE_TIME, SUBSTEPS
from benchmarks.tracing.rigs import make_rig, rms
from benchmarks.tracing.signals import delayed, play, relay, slew

LINEAR = Laws(1.75e-4, 5.5e-2, 1.75e-2, 1.35, 1.1e4, 5.5e-12, 55.0, 1.15e-4, 7e8)
STEP = SAMPLE_TIME / SUBSTEPS


def state_space(r):
    """Return A, B of the linear laws for inputs (u_m, theta_d), and C, D of T_g."""
    c = r.V_m / (4 * r.beta_e)
    a = np.array([
        [-1 / r.K_p, 0, 0, 0],
        [r.K_q / c, -r.K_ce / c, -r.D_m / c, 0],
        [0, r.D_m / r.J, -r.B_m / r.J, -r.G / r.J],
        [0, 0, 1, 0]])
    b = np.array([[r.K_sv / r.K_p, 0], [0, 0], [0, r.G / r.J], [0, 0]])
    return a, b, np.array([[0, 0, 0, r.G]]), np.array([[0, -r.G]])


def drive(substeps=SUBSTEPS, seconds=0.3):
    """Return a command at every step, theta_d at every half step, and the step."""
    step = SAMPLE_TIME / substeps
    n = round(seconds / step)
    t = 0.5 * step * np.arange(2 * n + 1)
    return 0.15 * np.sin(2 * np.pi * 7 * t[1::2]), 0.01 * (1 - np.cos(2 * np.pi * 5 * t)), step


def test_a_rig_without_effects_is_the_linear_laws():
    u, angle, step = drive()
    _, torque = integrate(LINEAR, u, angle, 0.0, step, 1)
    a, b, c, d = state_space(LINEAR)
    t = step * np.arange(len(u))
    _, by_command, _ = lsim((a, b[:, :1], c, d[:, :1]), u, t, interp=False)
    _, by_shaft, _ = lsim((a, b[:, 1:], c, d[:, 1:]), angle[:-1:2], t)
    assert np.abs(torque).max() > 20
    np.testing.assert_allclose(torque, by_command + by_shaft, atol=1e-3)


@pytest.mark.parametrize('friction', [
    {'coulomb': 8.0, 'static': 8.0},
    {'coulomb': 5.0, 'static': 9.0, 'stribeck': 0.1},
    {'load_friction': 0.2},
])
def test_friction_only_takes_energy(friction):
    r = LINEAR._replace(**friction)
    u, angle, step = drive()
    states, torque = integrate(r, u, angle, 0.0, step, 1)
    p, omega = states[:, 1], states[:, 2]
    power = (r.D_m * p - r.B_m * omega - torque) * omega
    into_inertia = 0.5 * r.J * np.diff(omega**2)
    taken = step * (power[1:] + power[:-1]) / 2 - into_inertia
    assert (omega == 0).any(), 'the motor never stuck'
    assert taken.sum() > 0.01
    # what the trapezoid misses, at most
    assert taken.min() > -1e-4 * taken.sum()


@pytest.mark.parametrize(('kind', 'effect', 'index'), [
    (kind, effect, i) for kind, of_kind in LAWS.items() for effect, laws in of_kind.items()
    for i in range(len(laws))])
def test_no_law_depends_on_the_step(kind, effect, index):
    scales = Scales(u=0.15, x=1.5e-5, x_rate=7e-4, p=2.5e6, omega=0.5, span=0.02, torque=40.0,
                    duration=0.3)
    fields = LAWS[kind][effect][index][1](scales, np.random.default_rng(3))
    assert fields
    assert set(fields) <= {*Laws._fields, *Command._fields, *Sensor._fields}
    laws, command = (
        part._replace(**{k: v for k, v in fields.items() if k in part._fields})
        for part in (LINEAR, Command()))
    torques = []
    for substeps in (SUBSTEPS // 2, SUBSTEPS, SUBSTEPS * 2):
        u, angle, step = drive(substeps)
        torques.append(integrate(laws, command.on(u, step), angle, 0.0, step, substeps)[1])
    coarse, usual, fine = torques
    assert np.isfinite(fine).all()
    assert rms([usual - fine]) < 0.005 * rms([fine])
    assert rms([coarse - fine]) < 0.01 * rms([fine])


def held(r, u):
    """Return the final state and torque under a constant command with the shaft held."""
    n = round(1.5 / STEP)
    states, torque = integrate(r, np.full(n, u), np.zeros(2 * n + 1), 0.0, STEP, SUBSTEPS)
    return states[-1], torque[-1]


def test_steady_state_of_an_orifice():
    r = LINEAR._replace(supply_high=7e6, supply_low=7e6)
    (x, p, *_), torque = held(r, 0.2)
    assert r.K_q * x * np.sqrt(1 - p / 7e6) == pytest.approx(r.K_ce * p, rel=1e-4)
    assert torque == pytest.approx(r.D_m * p, rel=1e-4)
    assert held(r, -0.2)[1] == pytest.approx(-torque, rel=1e-6)


def test_an_overlap_passes_nothing_inside_it():
    r = LINEAR._replace(dead_low=1e-5, dead_high=2e-5)
    assert held(r, 1.9e-5 / r.K_sv)[1] == 0
    assert held(r, -1.9e-5 / r.K_sv)[1] == pytest.approx(held(LINEAR, -0.9e-5 / r.K_sv)[1])


def test_turbulent_leakage_in_steady_state():
    r = LINEAR._replace(leak_root=1e-9)
    (x, p, *_), _ = held(r, 0.1)
    assert r.K_q * x == pytest.approx(r.K_ce * p + 1e-9 * np.sqrt(p), rel=1e-3)


def test_a_stiffening_shaft_twists_less():
    r = LINEAR._replace(cubic=2e4)
    (_, p, _, twist, *_), torque = held(r, 0.1)
    assert torque == pytest.approx(r.G * (twist + 2e4 * twist**3), rel=1e-6)
    assert torque == pytest.approx(r.D_m * p, rel=1e-4)


def test_what_befalls_a_command():
    u = np.array([0.0, 1.0, 2.0, 1.5, 0.5, -2.0])
    np.testing.assert_allclose(play(u, 0.5), [0, 0.5, 1.5, 1.5, 1.0, -1.5])
    np.testing.assert_allclose(relay(u, 1.2, 0.1), [0, 1.0, 2.1, 1.6, 0.6, -2.1])
    np.testing.assert_allclose(slew(u, 0.6), [0, 0.6, 1.2, 1.5, 0.9, 0.3])
    np.testing.assert_allclose(delayed(u, 0.02, 0.01, 'pure'), [0, 0, 0, 1.0, 2.0, 1.5])


@pytest.mark.parametrize('kind', ['pade', 'lags'])
def test_a_soft_delay_shifts_a_slow_sine(kind):
    t = 1e-4 * np.arange(20_000)
    late = delayed(np.sin(2 * np.pi * t), 0.01, 1e-4, kind)
    np.testing.assert_allclose(late[5000:], np.sin(2 * np.pi * (t - 0.01))[5000:], atol=2e-3)


def test_a_seed_is_a_rig():
    one, again = (make_rig(12, 'pair', ('friction', 'bias'), 'chirp') for _ in range(2))
    for a, b in zip(one.series, again.series, strict=True):
        for name in ('u_m', 'theta_d', 'T_g'):
            np.testing.assert_array_equal(a[name], b[name])
    noisy = make_rig(12, 'pair', ('friction', 'bias'), 'chirp', snr_db=26.0)
    np.testing.assert_array_equal(one.clean[1], noisy.clean[1])
    assert [b.id for b in one.truth.built] == ['friction', 'bias']
    assert noisy.truth.noise_rms == pytest.approx(rms(noisy.clean) / 10**1.3, rel=0.2)


@pytest.mark.parametrize('seed', range(4))
def test_the_torque_stays_within_what_the_rig_bears(seed):
    rig = make_rig(seed, 'outside', ('resonance',), 'steps')
    assert len(rig.recording().series) == 3
    assert all(len(s) == 1500 for s in rig.recording().series)
    assert 5 < max(np.abs(c).max() for c in rig.clean) < 165
