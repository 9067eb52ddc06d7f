"""Laws averaged over what is not known, against sums over many points."""
import numpy as np
import pytest

from hydro_twin.effects import EFFECTS
from hydro_twin.effects.dispatch import apply, code
from hydro_twin.predictors.linearise import average, differentiate, straight, WEIGHTS

CASES = {                               # parameters, steepest slope of a signal read, and where
    'dead_zone': ((3.0, 0.5, 0.1), 0.0, (-4.0, -2.5, 0.5, 3.0, 8.0)),
    'saturation': ((-2.0, 3.0, 0.0), 0.0, (-3.0, 0.0, 2.9)),
    'friction': ((2.0, 0.0, 1.0, np.inf, 0.0), 10.0, (-0.2, 0.0, 0.15, 0.4)),
}


def law_at(name, v, read, c=0.1):
    p = np.array(CASES[name][0])
    effect = next(e for e in EFFECTS if e.id == name)
    z = np.zeros(effect.memory)
    return (code(effect), v, np.array([read, 0.0]), p, z, 1e-3, c, z.copy())


@pytest.mark.parametrize('name', CASES)
@pytest.mark.parametrize('deviation', [0.3, 1.5])
def test_mean_slope_and_rest_are_those_of_the_normal_distribution(name, deviation):
    _, reads, places = CASES[name]
    share = np.linspace(-6.0, 6.0, 4001)
    weight = np.exp(-0.5 * share ** 2) / np.exp(-0.5 * share ** 2).sum()
    deviation /= reads or 1.0           # free velocity: the force 2 stops 0.2
    scale = (reads or 1.0) * deviation
    step = 0.5 * WEIGHTS.max()          # of a mean slope, where a corner passes a point
    for place in places:
        read, v = (place, 0.0) if reads else (0.0, place)
        dv, ds = (0.0, deviation) if reads else (deviation, 0.0)
        arguments = law_at(name, v, read)
        rows, columns = 1 + len(arguments[4]), 4 + len(arguments[3]) + len(arguments[4])
        g = np.zeros((rows, columns))
        mean, rest = average(*arguments, g, np.zeros((rows, columns + 1)), dv, ds)
        exact = np.array([apply(*law_at(name, v + dv * q, read + ds * q)) for q in share])
        variance = weight @ exact ** 2 - (weight @ exact) ** 2
        found = g[0, 0] * dv + g[0, 1] * ds
        assert mean == pytest.approx(weight @ exact, abs=0.03 * scale)
        assert found == pytest.approx(weight @ (exact * share), abs=1.05 * step * scale)
        assert found ** 2 + rest ** 2 == pytest.approx(variance, abs=0.15 * scale ** 2)


def test_away_from_its_corners_a_law_is_straight():
    for place, expected in [(8.0, True), (3.6, False)]:
        arguments = law_at('dead_zone', place, 0.0)
        g = np.zeros((1, 7))
        value = differentiate(*arguments, g)
        assert straight(*arguments, g, value, 0.3, 0.0) == expected
