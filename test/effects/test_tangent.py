"""The derivatives generated for laws, against differences, and at kinks."""
from __future__ import annotations

import math

import numpy as np
import pytest

from hydro_twin.compiled import compiled
from hydro_twin.effects import bias, curve, dead_zone, EFFECTS, friction
from hydro_twin.effects.differentiate import NoTangent
from hydro_twin.effects.rules import PRELUDE
from hydro_twin.effects.tangent import law_differences, law_tangent, WEIGH


def generated(source: str, **names):
    """Run generated code as plain Python, for its derivatives do not depend on the compiler."""
    space = dict(names)
    exec((PRELUDE + WEIGH + source).replace('@compiled\n', ''), space)
    return space['tangent']


def evaluate(function, v, s, p, z, h, c):
    z_next, partial = z.copy(), np.full((1 + len(z), 4 + len(p) + len(z)), np.nan)
    value = function(v, s.copy(), p.copy(), z.copy(), h, c, z_next, partial)
    return value, z_next, partial


LAWS = [(e, e.law) for e in EFFECTS if e.law is not None] + [(curve.CURVE, curve.law)]


@pytest.mark.parametrize(('effect', 'law'), LAWS, ids=lambda x: getattr(x, 'id', ''))
def test_every_law_against_its_differences(effect, law):
    """Away from kinks, and in steps over which rounding does not spoil the differences."""
    h = 0.3 if effect.dynamic else 1e-3
    rng = np.random.default_rng(0)
    exact = generated(law_tangent(law, 'tangent'))
    near = generated(law_differences('law', 'tangent'), law=law)
    tried = 0
    for _ in range(40):
        v, c, s = rng.uniform(-2, 2), rng.uniform(0.1, 1), rng.uniform(-2, 2, 2)
        z = rng.uniform(-2, 2, effect.memory)
        p = rng.uniform(0.1, 0.9, len(effect.parameters))
        if effect is curve.CURVE:
            p[:2] = -1.0, 1.0
        value, kept, found = evaluate(exact, v, s, p, z, h, c)
        same, also, expected = evaluate(near, v, s, p, z, h, c)
        assert (value, list(kept)) == (same, list(also))
        tried += np.abs(found).sum() > 0.0
        size = max(np.abs(expected).max(), 1.0)
        np.testing.assert_allclose(found, expected, atol=1e-6 * size)
    assert tried > 10


def test_a_number_made_a_float_keeps_its_derivative():
    def law(v, s, p, z, h, c, z_next):
        return float(v) * p[0]

    _, _, partial = evaluate(generated(law_tangent(law, 'tangent')), 3.0, np.zeros(2),
                             np.array([0.5]), np.zeros(0), 0.0, 0.0)
    assert (partial[0, 0], partial[0, 4]) == (0.5, 3.0)


def test_at_a_kink_the_side_is_the_one_stated():
    tangent = generated(law_tangent(dead_zone.law, 'tangent'))
    p = np.array([0.5, 0.0, 0.0])
    _, _, inside = evaluate(tangent, 0.5, np.zeros(2), p, np.zeros(0), 0.0, 0.0)
    assert inside[0, 0] == 0.0              # min takes its first argument, the value
    _, _, beyond = evaluate(tangent, math.nextafter(0.5, 1.0), np.zeros(2), p, np.zeros(0),
                            0.0, 0.0)
    assert beyond[0, 0] == 1.0


def test_sticking_friction_moves_with_what_stops_it():
    """Held still at the end of a step, the mass is as still whatever the force."""
    tangent = generated(law_tangent(friction.law, 'tangent'))
    p = np.array([1.0, 0.0, 1.0, math.inf, 0.0])
    _, kept, found = evaluate(tangent, 0.0, np.array([0.01, 0.0]), p, np.zeros(2), 1e-3, 0.1)
    assert kept[1] == 0.0
    assert found[0, 1] == pytest.approx(-10.0)      # the force gives way: 1 / c
    assert not found[2].any()


def test_a_law_that_is_not_understood_is_refused():
    @compiled
    def law(v, s, p, z, h, c, z_next):
        return sum([v, p[0]])

    with pytest.raises(NoTangent):
        law_tangent(law, 'tangent')


SCALE = np.sqrt(2.0)


@compiled
def total(numbers):
    return numbers[0] + numbers[1]


@compiled
def half(number):
    return 0.5 * number


def over_all(v, s, p, z, h, c, z_next):
    value = v
    for i in range(len(p)):
        value += p[i]
    return value


def by_helper(v, s, p, z, h, c, z_next):
    return v + total(p)


def of_the_step(v, s, p, z, h, c, z_next):
    return v * half(h)


@pytest.mark.parametrize('law', [over_all, by_helper, of_the_step])
def test_what_generated_code_cannot_follow_or_does_not_know_is_refused(law):
    """An index that a loop moves, an array given away, a function that is not written out."""
    with pytest.raises(NoTangent):
        law_tangent(law, 'tangent')


def test_a_constant_of_numpy_is_written_as_a_number():
    def law(v, s, p, z, h, c, z_next):
        return SCALE * v

    _, _, partial = evaluate(generated(law_tangent(law, 'tangent')), 3.0, np.zeros(2),
                             np.zeros(0), np.zeros(0), 0.0, 0.0)
    assert partial[0, 0] == math.sqrt(2.0)


def test_a_bias_is_as_simple_as_it_gets():
    assert law_tangent(bias.law, 'tangent').count('partial_[0') == 2
