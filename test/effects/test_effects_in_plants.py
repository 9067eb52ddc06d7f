"""Every effect on every plant that takes it: its limits, its energy, and the time stepping."""
import math

from loaded_cylinder import moved
import numpy as np
import pytest
from scipy import integrate, signal

from hydro_twin.effects import EFFECTS, Placed, sites
from hydro_twin.fitting.parts import Part
from hydro_twin.inference.screen import spans
from hydro_twin.model import Model, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.system import assemble

INF = math.inf
NEUTRAL = {   # parameters with which a law changes nothing
    'friction': (0.0, 0.0, 1.0, INF, 0.0), 'dead_zone': (0.0, 0.0, 0.0), 'backlash': (0.0,),
    'saturation': (-INF, INF, 0.0), 'rate_limit': (INF, 0.0, 0.0), 'hysteresis': (0.0, 1.0),
    'delay': (0.0,), 'lag': (0.0,), 'mode': (1e15, 1.0), 'flexible_load': (5.0, 0.1, 0.0, 1.0),
    'asymmetry': (0.0,), 'bias': (0.0,), 'orifice': (INF,), 'leakage': (0.0, 0.5),
    'stiffening': (0.0, 0.0, 1.0),
    'ripple': (0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 0.0), 'gain': (0.0,), 'end_stop': (-1e9, 1e9),
}
AT_KIND = {         # of the same name
    ('orifice', 'speed'): (INF, 0.0, 0.0, 0.0), ('friction', 'balance'): (0.0,)}
SITES = [(plant, effect, port) for plant in PLANTS.values() for effect in EFFECTS
         for port in sites(effect, plant) if effect.course is None]
AMPLITUDES = {'u_m': 0.4, 'theta_d': 0.1, 'force': 100.0}


def named(site):
    plant, effect, port = site
    return f'{plant.name}-{effect.id}-{port.name}'


def values(plant):
    return plant.constant_values() | {p.name: (p.lower * p.upper) ** 0.5
                                      for p in plant.parameters}


def neutral(effect):
    """Return parameters with which a law changes nothing."""
    return AT_KIND.get((effect.id, effect.kinds[0]), NEUTRAL[effect.id])


def smooth(plant, samples=600):
    """Smooth random inputs that begin at zero."""
    rng = np.random.default_rng(0)
    t = plant.sample_time * np.arange(samples)
    corner = min(5.0, 0.01 / plant.sample_time)        # [Hz]
    low = signal.butter(2, corner, fs=1 / plant.sample_time, output='sos')
    return np.column_stack([
        AMPLITUDES.get(s.name, 1.0) * np.tanh(t / 0.05) * 4
        * signal.sosfilt(low, rng.standard_normal(samples)) for s in plant.inputs])


def run(plant, effects=(), substeps=4, inputs=None):
    inputs = smooth(plant) if inputs is None else inputs
    return assemble(plant, values(plant), effects, substeps=substeps).run(
        inputs, np.zeros(plant.order))


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


@pytest.mark.parametrize('site', SITES, ids=named)
def test_without_strength_it_is_the_linear_model(site):
    plant, effect, port = site
    linear = run(plant)
    found = run(plant, [Placed(effect, port, neutral(effect))])
    np.testing.assert_allclose(found, linear, rtol=0, atol=1e-9 * np.abs(linear).max())


@pytest.mark.parametrize('site', SITES, ids=named)
def test_without_strength_it_is_the_linear_model_where_a_command_acts_within_a_sample(site):
    """A better time step must not be credited to an effect."""
    plant, effect, port = site
    delay = place('delay', 'command', {'time': 1.6 * plant.sample_time}, plant)
    linear = run(plant, [delay])
    found = run(plant, [delay, Placed(effect, port, neutral(effect))])
    np.testing.assert_allclose(found, linear, rtol=0, atol=1e-9 * np.abs(linear).max())


@pytest.mark.parametrize('site', [site for site in SITES if any(
    p.scales for p in site[1].parameters)], ids=named)
def test_half_as_strong_it_moves_the_output_half_as_far(site):
    plant, effect, port = site
    part = Part(smooth(plant), np.zeros(600))
    reach = spans(Model(plant, values(plant), plant.sample_time, ()), [part])[port]
    weak = Placed(effect, port, tuple(effect.starts(reach)[0])).scaled(0.1)
    linear = run(plant)
    once, half = (run(plant, [placed]) - linear for placed in (weak, weak.scaled(0.5)))
    assert rms(half) / rms(once) == pytest.approx(0.5, rel=0.3)


@pytest.mark.parametrize('plant', PLANTS.values(), ids=PLANTS)
def test_all_together_without_strength_are_the_linear_model(plant):
    linear = run(plant)
    every = [Placed(effect, port, neutral(effect)) for p, effect, port in SITES if p is plant]
    np.testing.assert_allclose(run(plant, every), linear, rtol=0,
                               atol=1e-9 * np.abs(linear).max())


@pytest.mark.parametrize('site', SITES, ids=named)
def test_halving_the_step_changes_little(site):
    """From weak to dominant: 4 steps in a sample differ from 8 by 0.2 % of the output (RMS).

    With friction, whose sticking begins and ends within a step, by 0.5 %.
    """
    plant, effect, port = site
    inputs = smooth(plant)
    linear = Model(plant, values(plant), plant.sample_time)
    part = Part(inputs, linear.system.run(inputs, np.zeros(plant.order)))
    span = spans(linear, [part])[port]
    strengths = [tuple(start) for start in effect.starts(span)]
    if effect.refined is not None:
        strengths += [tuple(r) for s in strengths[:4] for r in effect.refined(span, s)]
    if effect.id == 'ripple':               # three periods, however little the motor turns
        waves = 0.1 * span.value, 0.2 * span.value, 6 * np.pi / span.travel['position']
        strengths = [(*waves, *harmonics) for harmonics in [(0.0,) * 4, waves[:2] * 2]]
    largest = 0.0
    for strength in strengths[::max(1, len(strengths) // 12)]:
        placed = [Placed(effect, port, strength)]
        coarse, fine = run(plant, placed, 4, inputs), run(plant, placed, 8, inputs)
        assert np.isfinite(fine).all()
        tolerance = 5e-3 if effect.implicit else 2e-3
        assert rms(coarse - fine) < tolerance * rms(fine)
        largest = max(largest, rms(fine - part.measured) / rms(part.measured))
    assert largest > 1e-3, 'no strength moved the output'


def pushed(force, samples=1500, substeps=4, **parameters):
    """Run a mass under a force over time, with friction; position and velocity."""
    plant = PLANTS['positioning']
    system = assemble(plant, {'M': 10.0, 'F_v': 5.0},
                      [place('friction', 'motor', parameters, plant)], 0.001, substeps)
    seen = np.empty((samples, len(plant.ports) + 2))
    x = system.run(force(0.001 * np.arange(samples))[:, None], np.zeros(2), seen=seen)
    return x, seen[:, -2]


@pytest.mark.parametrize('parameters', [
    {'coulomb': 8.0}, {'coulomb': 5.0, 'stribeck': 3.0, 'stribeck_velocity': 0.01}])
def test_below_its_force_friction_holds_without_chatter(parameters):
    x, v = pushed(lambda t: 7.9 * np.sin(2 * np.pi * 3 * t), **parameters)
    assert np.abs(v).max() < 1e-12
    assert np.abs(x).max() < 1e-12


def test_a_stem_with_friction_stands_until_the_spring_is_off_by_it():
    """A command that rises and falls again, against the solution piece by piece."""
    plant, rate, friction = PLANTS['control_valve'], 0.1, 0.03
    v = {'tau': 2.0, 'K': 1.0}
    t = np.arange(301) * 0.1
    command = rate * np.minimum(t, 20.0 - t)
    found = assemble(plant, v, [place('friction', 'spring', {'coulomb': friction}, plant)],
                     0.1, 4, interpolation='linear').run(command[:, None], np.zeros(1))

    def from_rest(since):
        """Return what a ramp moves, behind the lag, from when the force exceeds friction."""
        since = np.maximum(since, 0.0)
        return rate * (since - v['tau'] * (1.0 - np.exp(-since / v['tau'])))

    rising = t <= 10.0
    np.testing.assert_allclose(found[rising], from_rest(t[rising] - friction / rate), atol=2e-4)
    top = found.max()
    still = np.isclose(found, top, rtol=0.0, atol=1e-5)
    # It goes on until the command has come down to friction above it, and stands until it is as
    # far below.
    assert command[still][0] - top == pytest.approx(friction, abs=rate * 0.1)
    assert top - command[still][-1] == pytest.approx(friction, abs=rate * 0.1)
    back = t > t[still][-1]
    falls = 20.0 - (top - friction) / rate
    np.testing.assert_allclose(found[back], top - from_rest(t[back] - falls), atol=5e-4)


def test_friction_sticks_at_each_turn_and_slides_between():
    _, v = pushed(lambda t: 12.0 * np.sin(2 * np.pi * 1 * t), coulomb=8.0)
    still = np.abs(v) < 1e-12
    # While the force is between -8 and 8, 46 % of a period, less the time in which it slides out.
    assert 0.1 < still[500:].mean() < 0.46
    assert np.count_nonzero(np.diff(still.astype(int))) < 10


def slides(v, force, duration, M=10.0, F_v=5.0, F_c=8.0):
    """Move a mass for a while from speed v under a constant force: travel, and speed then.

    Piece by piece in closed form: M v' + F_v v = force - F_c sign(v), or at rest.
    """
    if v == 0.0 and abs(force) <= F_c:
        return 0.0, 0.0
    last = (force - math.copysign(F_c, v or force)) / F_v
    stops = M / F_v * math.log1p(-v / last) if v * last < 0.0 else math.inf
    moved = min(stops, duration)
    then = last + (v - last) * math.exp(-moved * F_v / M)
    travel = last * moved + (v - then) * M / F_v
    if stops >= duration:
        return travel, then
    rest, then = slides(0.0, force, duration - stops, M, F_v, F_c)
    return travel + rest, then


def test_a_mass_that_turns_back_within_a_step_of_time_is_where_it_should_be():
    """A turn is at no multiple of the step; were it moved to one, the speed would be off by it."""
    steps = np.repeat(np.random.default_rng(0).uniform(-30.0, 30.0, 150), 10)
    x, v, true = 0.0, 0.0, [0.0]
    for force in steps[:-1]:
        travel, v = slides(v, force, 0.001)
        x += travel
        true.append(x)

    def off(substeps):
        return rms(pushed(lambda t: steps, substeps=substeps, coulomb=8.0)[0] - true)

    assert np.ptp(true) > 0.01
    assert off(1) < 1e-6
    assert off(4) < 0.1 * off(1)


@pytest.mark.parametrize('parameters', [
    {'coulomb': 8.0}, {'coulomb': 5.0, 'stribeck': 3.0, 'stribeck_velocity': 0.01},
    {'coulomb': 8.0, 'bristle_stiffness': 1e5}])
def test_friction_takes_energy_over_every_cycle(parameters):
    """What the drive puts in over a period goes into viscous and dry friction; dry takes some."""
    force = 20.0
    x, v = pushed(lambda t: force * np.sin(2 * np.pi * 2 * t), 4000, 16, **parameters)
    t = 0.001 * np.arange(4000)
    cycle = slice(3000, 3500)
    # The force is held between samples: its work is that on the way to the next sample.
    work = np.sum((force * np.sin(2 * np.pi * 2 * t))[cycle] * np.diff(x)[cycle])
    viscous = np.sum(5.0 * v[cycle] ** 2) * 0.001
    travel = np.sum(np.abs(np.diff(x)[cycle]))
    dry = work - viscous
    assert dry > 0.9 * parameters['coulomb'] * travel
    assert dry < 1.02 * (parameters['coulomb'] + parameters.get('stribeck', 0.0)) * travel


STOPPED = [(plant, port) for plant, effect, port in SITES if effect.id == 'end_stop']


@pytest.mark.parametrize(('plant', 'port'), STOPPED, ids=lambda one: one.name)
@pytest.mark.parametrize('substeps', [1, 4, 16])
def test_an_end_stop_takes_just_the_speed_that_leads_beyond(plant, port, substeps):
    """Complementarity: within the stroke it adds nothing, at its end it pushes back only."""
    placed = place('end_stop', port.name, {'lower': -0.4, 'upper': 0.2}, plant)
    k = len(plant.ports) + sum(len(p.signals) for p in plant.ports[:plant.ports.index(port)])
    row = k + list(port.signals).index('position')
    step = np.concatenate([np.full(400, 1e3), np.full(600, -1e3)])[:, None]
    inputs = (smooth(plant, 1000) if plant.name != 'cylinder' else step * 1e-3 * values(
        plant)['tau'])
    system = assemble(plant, values(plant), [placed], plant.sample_time, substeps)
    linear = assemble(plant, values(plant), [], plant.sample_time)
    inputs *= 3.0 / np.abs(linear.run(inputs, np.zeros(plant.order))).max()     # well beyond
    seen = np.empty((1000, len(system.step.H)))
    system.run(inputs, np.zeros(plant.order), seen=seen)
    position = seen[:, row]
    assert position.max() == pytest.approx(0.2, abs=1e-9)
    assert position.min() == pytest.approx(-0.4, abs=1e-9)
    speed = seen[:, plant.ports.index(port)]        # that the drive asks for
    at_upper = position > 0.2 - 1e-9
    stays = at_upper[:-1] & at_upper[1:]
    assert stays.any()
    assert (speed[:-1][stays] > -1e-3 * np.abs(speed).max()).all()      # driven against it


def test_a_cylinder_leaves_its_end_as_soon_as_it_is_driven_back():
    """Against the law by scipy, with the events of a stop; what winds up would be late."""
    plant = PLANTS['cylinder']
    p = values(plant) | {'tau': 0.02, 'K_v': 0.5}
    t = plant.sample_time * np.arange(1500)
    command = np.sin(2 * np.pi * 0.5 * t)

    def rates(time, x):
        q, position = x
        speed = p['K_v'] * q
        blocked = (position >= 0.1 and speed > 0) or (position <= -0.05 and speed < 0)
        held = command[min(int(time / plant.sample_time + 1e-9), len(t) - 1)]
        return [(held - q) / p['tau'], 0.0 if blocked else speed]

    x, true = np.zeros(2), [0.0]
    fine = plant.sample_time / 200
    for k in range((len(t) - 1) * 200):
        x = x + fine * np.array(rates(k * fine, x))
        x[1] = min(max(x[1], -0.05), 0.1)
        if (k + 1) % 200 == 0:
            true.append(x[1])
    placed = place('end_stop', 'piston', {'lower': -0.05, 'upper': 0.1}, plant)
    found = assemble(plant, p, [placed]).run(command[:, None], np.zeros(2))
    np.testing.assert_allclose(found, true, atol=2e-4)


@pytest.mark.parametrize(('placed_first', 'substeps'), [('orifice', 1), ('end_stop', 4)])
def test_a_mass_at_its_end_has_lost_its_speed(placed_first, substeps):
    """Against small steps of the law; with the speed that it had it would leave its end late."""
    plant = PLANTS['cylinder']
    p = values(plant) | {'tau': 0.02, 'K_v': 0.5}
    load = {'full_load_speed': 2.0, 'imbalance': 0.0, 'inertia': 0.2, 'compliance': 0.003}
    t = plant.sample_time * np.arange(1500)
    command = np.sin(2 * np.pi * 0.5 * t)
    true, _ = moved(command, plant.sample_time, p['tau'], p['K_v'], load, (-0.05, 0.1))
    assert max(true) == 0.1
    assert min(true) == -0.05
    effects = [place('orifice', 'piston', load, plant),
               place('end_stop', 'piston', {'lower': -0.05, 'upper': 0.1}, plant)]
    if placed_first == 'end_stop':
        effects.reverse()
    found = assemble(plant, p, effects, substeps=substeps).run(command[:, None], np.zeros(2))
    np.testing.assert_allclose(found, true, atol=4e-4)


def test_a_delay_of_whole_samples_shifts_the_output():
    plant = PLANTS['cylinder']
    on_time = run(plant)
    late = run(plant, [place('delay', 'command', {'time': 7 * plant.sample_time}, plant)])
    np.testing.assert_allclose(late[7:], on_time[:-7], rtol=0, atol=1e-12 * np.abs(late).max())


def test_a_delay_of_part_of_a_sample():
    """Against scipy at an eighth of the sample time.

    A command that changes within a step counts by its mean there, which is of second order, and
    exact where it changes between two steps.
    """
    plant = PLANTS['valve_servo']
    laws = plant.laws(values(plant))
    inputs = smooth(plant)
    fine = np.concatenate([np.full(13, inputs[0, 0]), np.repeat(inputs[:, 0], 8)[:-13]])
    discrete = signal.cont2discrete((laws.A, laws.B, laws.C, laws.D), plant.sample_time / 8)
    expected = signal.dlsim(discrete, fine)[1][::8, 0]

    def off(samples, substeps=1):
        time = samples * plant.sample_time
        found = run(plant, [place('delay', 'command', {'time': time}, plant)], substeps)
        return rms(found - expected) / rms(expected)

    assert off(13 / 8) < 3e-4
    assert off(13 / 8) < 0.03 * min(off(1), off(2))
    assert off(13 / 8, 8) < 1e-9 < off(13 / 8, 2) < 0.3 * off(13 / 8)


def test_effects_on_one_port_act_one_after_the_other():
    """A command of 1 V through a dead zone of 0.3 and a limit of 0.5 is one of 0.5."""
    plant = PLANTS['load_simulator']
    both = [place('dead_zone', 'command', {'width': 0.3}, plant),
            place('saturation', 'command', {'lower': -0.5, 'upper': 0.5}, plant)]
    inputs = np.column_stack([np.ones(300), np.zeros(300)])
    half = np.column_stack([np.full(300, 0.5), np.zeros(300)])
    np.testing.assert_allclose(run(plant, both, inputs=inputs), run(plant, inputs=half),
                               rtol=0, atol=1e-9)


@pytest.mark.parametrize('port', ['linkage', 'stem'])
def test_a_dead_zone_behind_the_actuator_equals_an_integrator(port):
    """At the linkage it is within the loop, which moves the actuator past it; at the stem not."""
    plant, width = PLANTS['valve_servo'], 0.2
    p = values(plant)

    def passed(x):
        return np.sign(x) * max(abs(x) - width, 0.0)

    def laws(t, x):
        c, a, y = x
        linkage = passed(a) if port == 'linkage' else a
        return [(p['k_1'] * (np.sin(t) - y) - c) / p['T_y'], c / p['T_c'],
                (linkage - y) / p['tau']]

    t = plant.sample_time * np.arange(2000)
    true = integrate.solve_ivp(laws, (0, t[-1]), np.zeros(3), t_eval=t, rtol=1e-9, atol=1e-11,
                               method='LSODA').y[2]
    if port == 'stem':
        true = np.array([passed(y) for y in true])
    found = run(plant, [place('dead_zone', port, {'width': width}, plant)],
                inputs=np.sin(t + plant.sample_time / 2)[:, None])      # held over each sample
    np.testing.assert_allclose(found, true, atol=2e-3)


def test_an_effect_upstream_is_felt_downstream():
    """A dead zone of the command at d volts is one of the spool at K_sv d, once it has settled."""
    plant = PLANTS['load_simulator']
    gain = values(plant)['K_sv']
    t = plant.sample_time * np.arange(2000)
    slow = np.column_stack([0.4 * np.sin(2 * np.pi * 0.25 * t), np.zeros_like(t)])
    upstream = run(plant, [place('dead_zone', 'command', {'width': 0.1}, plant)], inputs=slow)
    spool = run(plant, [place('dead_zone', 'spool', {'width': 0.1 * gain}, plant)], inputs=slow)
    assert rms(upstream - spool) < 0.03 * rms(spool)
    assert rms(spool - run(plant, inputs=slow)) > 0.1 * rms(spool)
