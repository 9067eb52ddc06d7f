"""A curve that stands for a law without a name: found where the law is, and only there."""
import numpy as np
import pytest
from traced_rig import fitted, record

from hydro_twin.effects.curve import values
from hydro_twin.residual.curve import find_curve
from hydro_twin.residual.passing import passing
from hydro_twin.residual.structure import free_curves


def found(*effects):
    fit, train, test = fitted(record(*effects))
    return find_curve(fit, train, test, free_curves(fit, train), 0)


def test_a_linear_rig_has_none():
    assert found() is None


@pytest.mark.slow
@pytest.mark.parametrize(('law', 'ports', 'shape'), [
    (('stiffening', 'coupling', {'cubic': 3e4}), {'coupling'}, lambda x: x**3),
    (('asymmetry', 'flow', {'imbalance': 0.2}), {'flow', 'spool'}, np.abs),
])
def test_is_the_law_but_for_a_straight_line(law, ports, shape):
    fit, train, test = fitted(record(law))
    curve = find_curve(fit, train, test, free_curves(fit, train), 0)
    placed = curve.placed
    assert placed.port.name in ports
    assert placed.effect.reads[0] in {'value', 'opening', 'twist'}
    assert curve.proof.low > 0.9
    model = curve.fit.candidate
    seen = [passing(model, placed, part).signals[placed.effect.reads[0]] for part in train]
    x = np.concatenate(seen)[::20]      # as often as the rig was there
    x = x[(x > placed.values[0]) & (x < placed.values[1])]

    def bent(y):
        return y - np.polyval(np.polyfit(x / x.max(), y, 1), x / x.max())

    # Where a twist is nought no signal says: the angle of the motor is not measured.
    drawn = bent(values(placed, x))
    assert max(np.corrcoef(drawn, bent(shape(x - zero)))[0, 1]
               for zero in np.linspace(-0.3, 0.3, 61) * x.max()) > 0.98
