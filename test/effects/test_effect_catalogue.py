"""What every effect must say of itself, whatever its law."""
import math

import pytest

from hydro_twin.effects import EFFECTS, MODULES, sites, Span
from hydro_twin.plants import PLANTS

IDS = {'friction', 'dead_zone', 'backlash', 'saturation', 'rate_limit', 'hysteresis', 'delay',
       'asymmetry', 'bias', 'orifice', 'leakage', 'stiffening', 'ripple', 'gain', 'end_stop',
       'lag', 'mode', 'flexible_load', 'drift'}
SITES = [(plant, effect, port) for plant in PLANTS.values() for effect in EFFECTS
         for port in sites(effect, plant)]


def named(site):
    plant, effect, port = site
    return f'{plant.name}-{effect.id}-{port.name}'


def wide(port):
    """Make a span in which every signal moves enough to show anything."""
    largest = {name: 5e6 if unit == 'Pa' else 3.0 for name, unit in port.signals.items()}
    return Span(((-2.0, 2.0),), {name: (-size, size) for name, size in largest.items()},
                (-2.0, 2.0), 0.002, 100)


def test_every_id_exists():
    assert {effect.id for effect in EFFECTS} == IDS


def test_the_load_simulator_takes_all_but_the_valves_gain_and_end_stop():
    assert {effect.id for plant, effect, _ in SITES
            if plant.name == 'load_simulator'} == IDS - {'gain', 'end_stop'}


def test_a_model_file_names_one_law():
    places = [(plant.name, effect.id, port.name) for plant, effect, port in SITES]
    assert len(set(places)) == len(places)


@pytest.mark.parametrize('effect', EFFECTS, ids=[name.rpartition('.')[2] for name in MODULES])
def test_every_effect_has_a_place_and_something_to_say(effect):
    assert any(e is effect for _, e, _ in SITES)
    assert effect.title
    assert effect.excitation
    assert (effect.law is None) == bool(effect.shifts or effect.course)
    if effect.law is not None:
        assert effect.law.py_func.__doc__


@pytest.mark.parametrize('effect', EFFECTS, ids=[name.rpartition('.')[2] for name in MODULES])
def test_parameters_have_bounds_that_hold(effect):
    assert len({p.name for p in effect.parameters}) == len(effect.parameters)
    for p in effect.parameters:
        assert p.lower < p.upper
        assert p.lower > 0.0 or not p.log
        assert p.refinement is None or p.lower <= p.refinement <= p.upper


@pytest.mark.parametrize('site', SITES, ids=named)
def test_a_search_starts_within_the_bounds_and_leads_to_the_simple_law(site):
    _, effect, port = site
    span = wide(port)
    starts = list(effect.starts(span))
    if effect.course is not None:           # which begins at what the residual says
        assert not starts
        starts = [(1e-2, 0.0, math.inf, 0.0, 60.0)]
    assert starts
    for start in starts:
        assert effect.distinguishable is None or effect.distinguishable(span, start)
        for p, value in zip(effect.parameters, start, strict=True):
            assert p.lower <= value <= p.upper
            assert p.refinement in (None, value) or effect.refined is not None
    if effect.refined is None:
        assert all(p.refinement is None for p in effect.parameters)
        return
    let_in = set()
    for start in effect.refined(span, starts[-1]):
        for p, value in zip(effect.parameters, start, strict=True):
            assert p.lower <= value <= p.upper
            if p.refinement is not None and value != p.refinement:
                let_in.add(p.name)
    without_position = {'bristle_stiffness'} if 'position' not in port.signals else set()
    assert let_in == {p.name for p in effect.parameters if p.refinement is not None} - (
        without_position)


@pytest.mark.parametrize('site', SITES, ids=named)
def test_starts_follow_the_unit_of_the_port(site):
    """In millivolts instead of volts, a search begins at the same place."""
    _, effect, port = site
    span = wide(port)
    thousand = Span(((1e3 * span.low, 1e3 * span.high),), span.signal_ranges, span.measured,
                    span.sample_time, span.lasting)
    for one, other in zip(effect.starts(span), effect.starts(thousand), strict=True):
        for p, a, b in zip(effect.parameters, one, other, strict=True):
            in_value = p.unit.split('/')[0] == 'value' and a != p.refinement
            assert b == pytest.approx(1e3 * a if in_value else a)


@pytest.mark.parametrize('site', SITES, ids=named)
def test_units_are_written_out(site):
    _, effect, port = site
    for p in effect.parameters:
        unit = effect.unit(p, port)
        assert all(unit.split('/'))
        assert not any(name in unit for name in ('value', 'position', 'velocity'))
        assert not any(name in unit for name in port.signals)


def test_units_of_a_port():
    def unit(identifier, name, of='load_simulator'):
        return next(effect.unit(p, port) for plant, effect, port in SITES
                    if plant.name == of and effect.id == identifier
                    for p in effect.parameters if p.name == name)

    assert unit('friction', 'coulomb') == 'N m'
    assert unit('friction', 'stribeck_velocity') == 'rad/s'
    assert unit('friction', 'bristle_stiffness') == 'N m/rad'
    assert unit('backlash', 'gap') == 'rad'
    assert unit('stiffening', 'cubic') == '1/rad^2'
    assert unit('rate_limit', 'limit') == 'm/s'
    assert unit('delay', 'time') == 's'
    assert unit('flexible_load', 'stiffness', of='drive') == 'N m/rad'


def test_ripple_is_told_from_a_bias_only_by_a_tenth_of_a_period():
    ripple = next(effect for effect in EFFECTS if effect.id == 'ripple')
    span = Span(((-1.0, 1.0),), {'velocity': (-1.0, 1.0), 'position': (0.5, 1.0)},
                (-1.0, 1.0), 0.002, 100)
    assert not ripple.distinguishable(span, (1.0, 0.0, 0.3 * math.pi))
    assert ripple.distinguishable(span, (1.0, 0.0, 0.5 * math.pi))


def test_dead_zone_is_told_from_a_bias_only_where_it_is_entered():
    dead_zone = next(effect for effect in EFFECTS if effect.id == 'dead_zone')

    def shows(*ranges, leak=0.0):
        span = Span(ranges, {}, (0.0, 1.0), 0.002, 100)
        return dead_zone.distinguishable(span, (0.1, 0.0, leak))

    assert not shows((0.2, 1.0))
    assert not shows((-1.0, -0.2))
    assert shows((0.0, 1.0))
    assert shows((0.01, 1.0), leak=0.2)
    assert not shows((0.2, 1.0), (-1.0, -0.2))
    assert shows((0.2, 1.0), (-1.0, 0.2))


def test_a_mode_is_told_from_two_equal_lags_and_from_what_is_too_fast_to_be_sampled():
    for mode in (effect for effect in EFFECTS if effect.id == 'mode'):
        span = Span(((-1.0, 1.0),), {}, (-1.0, 1.0), 0.002, 100)
        assert mode.distinguishable(span, (30.0, 0.9))
        assert not mode.distinguishable(span, (30.0, 1.0))
        assert not mode.distinguishable(span, (251.0, 0.5))


def test_hysteresis_is_told_from_an_offset_of_each_part_only_where_its_loop_is_crossed():
    hysteresis = next(effect for effect in EFFECTS if effect.id == 'hysteresis')

    def shows(*ranges, added=0.0):
        span = Span(ranges, {}, (0.0, 1.0), 0.002, 100, added_swing=lambda: added)
        return hysteresis.distinguishable(span, (0.1, 1.0))

    assert shows((0.2, 0.5))
    assert not shows((0.2, 0.3), (-0.3, -0.2))
    assert shows((0.2, 0.3), added=0.2)         # met on both sides, and moved a little beyond
    assert not shows((0.2, 0.3), added=0.1)


def test_dead_zone_holds_rest_and_lets_little_pass():
    dead_zone = next(effect for effect in EFFECTS if effect.id == 'dead_zone')
    span = Span(((-1.0, 1.0),), {}, (0.0, 1.0), 0.002, 100)
    assert dead_zone.distinguishable(span, (0.1, -0.05, 0.3))
    assert not dead_zone.distinguishable(span, (0.1, -0.15, 0.0))
    assert not dead_zone.distinguishable(span, (0.1, 0.0, 0.7))


def test_leakage_is_told_from_laminar():
    leakage = next(effect for effect in EFFECTS if effect.id == 'leakage')
    span = wide(next(port for _, effect, port in SITES if effect is leakage))
    assert leakage.distinguishable(span, (1e-6, 0.5))
    assert leakage.distinguishable(span, (1e-6, 2.0))
    assert not leakage.distinguishable(span, (1e-6, 0.94))


def test_a_force_to_break_away_is_at_most_twice_that_of_sliding():
    friction = next(effect for effect in EFFECTS if effect.id == 'friction')
    span = Span(((-100.0, 100.0),), {}, (0.0, 1.0), 0.001, 100)
    assert friction.distinguishable(span, (20.0, 0.0, 1.0, math.inf, 0.0))
    assert friction.distinguishable(span, (20.0, 30.0, 0.01, math.inf, 0.0))
    assert not friction.distinguishable(span, (18.0, 90.0, 0.013, 3e6, 0.0))


def test_a_rate_limit_is_told_from_a_lag_only_where_it_lasts():
    rate_limit = next(effect for effect in EFFECTS if effect.id == 'rate_limit')

    def shows(samples):
        span = Span(((-0.3, 0.2),), {}, (0.0, 1.0), 0.05, samples)
        return rate_limit.distinguishable(span, (0.3, 0.0, 0.0))

    assert not shows(2)
    assert shows(3)


def test_a_soft_rate_limit_is_told_from_a_falling_gain_only_where_it_is_reached():
    rate_limit = next(effect for effect in EFFECTS if effect.id == 'rate_limit')
    span = Span(((-0.3, 0.2),), {}, (0.0, 1.0), 0.002, 100)
    assert rate_limit.distinguishable(span, (0.3, 0.0, 0.0))
    assert rate_limit.distinguishable(span, (0.35, 0.0, 0.4))
    assert not rate_limit.distinguishable(span, (0.7, 0.0, 0.4))
    assert not rate_limit.distinguishable(span, (0.35, 0.0, 0.45))   # as orifice flow is
    assert rate_limit.distinguishable(span, (0.7, -0.65, 0.3))       # upwards only


def test_friction_without_a_position_is_refined_without_bristles():
    effect = next(effect for effect in EFFECTS if effect.id == 'friction')
    span = Span(((-1.0, 1.0),), {'velocity': (-1.0, 1.0)}, (-1.0, 1.0), 0.002, 100)
    stiffness = [p.name for p in effect.parameters].index('bristle_stiffness')
    starts = effect.refined(span, (1.0, 0.0, 1.0, math.inf, 0.0))
    assert starts
    assert all(math.isinf(values[stiffness]) for values in starts)


@pytest.mark.parametrize(('slope', 'edges', 'changes'), [
    (0.5, (0.0, 1.0), True),
    (2900.0, (0.0, 1.0), False),        # next to nothing moves at zero
    (-0.9, (0.0, 1.0), False),
    (-0.2, (-2.7, -0.6), True),         # an angle whose zero is out of reach
    (0.4, (-2.7, -0.6), False),         # the gain would turn round
])
def test_a_gain_that_changes_is_never_next_to_none(slope, edges, changes):
    gain = next(effect for effect in EFFECTS if effect.id == 'gain')
    span = Span(((-1.0, 1.0),), {'position': edges}, (-1.0, 1.0), 0.002, 100)
    assert gain.distinguishable(span, (slope,)) is changes
