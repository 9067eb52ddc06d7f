import numpy as np
import pytest
from scipy.signal import lsim

from benchmarks.tracing.servo_laws import Around, DRAWS, integrate, Scales, Servo
from benchmarks.tracing.servos import case_of, make_rig, SAMPLE_TIME, shows, SUBSTEPS

LINEAR = Servo(T_y=0.0203, T_c=0.294, tau=0.00293, k_1=1.093)      # [L18]
STEP = SAMPLE_TIME / SUBSTEPS
TIME = STEP * np.arange(round(2.0 / STEP))


def opening(servo, u):
    return integrate(servo, u, 0.0, STEP, 1)


def test_a_servo_without_effects_is_the_transfer_function():
    u = 0.5 + 0.3 * np.sign(np.sin(2 * np.pi * 1.5 * TIME))
    r = LINEAR
    loop = ([r.k_1], [r.T_c * r.T_y * r.tau, r.T_c * (r.T_y + r.tau), r.T_c, r.k_1])
    _, y, _ = lsim(loop, u - u[0], TIME, interp=False)
    np.testing.assert_allclose(opening(LINEAR, u), u[0] + y, atol=2e-5)


def test_each_law_does_what_its_name_says():
    u = 0.5 + 0.3 * np.sin(2 * np.pi * TIME)
    free = opening(LINEAR, u)
    assert opening(LINEAR._replace(limit=0.6), u) == pytest.approx(np.minimum(free, 0.6))
    assert opening(LINEAR._replace(stop=0.6), u).max() == pytest.approx(0.6, abs=1e-3)
    slow = np.diff(opening(LINEAR._replace(speed_up=0.5, speed_down=0.3), u)) / STEP
    assert (slow.min(), slow.max()) == pytest.approx((-0.3, 0.5), rel=1e-3)
    assert abs(opening(LINEAR._replace(stem_play=0.02), u) - free).max() == pytest.approx(0.02)
    steady = opening(LINEAR._replace(dead=0.05), np.where(TIME < 0.1, 0.4, 0.7))
    assert steady[-1] == pytest.approx(0.65, abs=1e-3)
    assert opening(LINEAR._replace(curved=0.1), u) == pytest.approx(free * (1 + 0.1 * (1 - free)))


@pytest.mark.parametrize(('kind', 'index'), [
    (kind, i) for kind, draws in DRAWS.items() for i in range(len(draws))])
def test_no_law_depends_on_the_step(kind, index):
    scales = Scales(u=0.8, span=0.6, error=0.3, speed=1.0, top=0.8, duration=2.0)
    fields = DRAWS[kind][index][2](scales, np.random.default_rng(3))
    assert set(fields) <= {*Servo._fields, *Around._fields}
    servo = LINEAR._replace(**{k: v for k, v in fields.items() if k in Servo._fields})
    u = 0.5 + 0.3 * np.sin(2 * np.pi * TIME)
    coarse = opening(servo, u)
    fine = integrate(servo, np.repeat(u, 2), 0.0, STEP / 2, 2)
    np.testing.assert_allclose(coarse, fine, atol=2e-3 * np.ptp(coarse))


def test_a_seed_is_a_rig():
    one, other = make_rig(2002), make_rig(2002)
    assert case_of(2002)[0] == 'single'
    assert case_of(1_002_002) == case_of(2002)
    assert make_rig(1_002_002).servo != one.servo
    for a, b in zip(one.series, other.series, strict=True):
        np.testing.assert_array_equal(a['opening'], b['opening'])


def test_an_effect_shows_and_noise_does_not():
    assert abs(shows(make_rig(2))) < 0.02           # nothing built in
    assert shows(make_rig(2002)) > 1.0              # a dead zone
