"""What changed between two models, in one sentence."""
import numpy as np
from store_models import model

from hydro_twin.store.change import change, quantity


def backlash(gap, error):
    return [('backlash', 'coupling', {'gap': (gap, error)})]


def test_an_effect_that_grew_is_told_with_a_fitting_prefix():
    found = change(model(backlash(0.9e-3, 0.02e-3)), model(backlash(1.6e-3, 0.03e-3)))
    assert found.says == 'coupling backlash grew from 0.9 to 1.6 mrad'
    (moved,) = found.moved
    assert abs(moved.z - 0.7 / np.hypot(0.02, 0.03)) < 1e-9


def test_what_errors_explain_is_not_told():
    assert change(model(backlash(0.9e-3, 0.4e-3)), model(backlash(1.6e-3, 0.4e-3))).says == \
        'nothing changed beyond the errors'
    # Without an error in either file, nothing is claimed.
    assert not change(model(J=(0.03, None)), model(J=(0.06, 0.001))).moved


def test_effects_that_appear_and_go():
    friction = [('friction', 'motor', {'coulomb': (10.2, 0.1)})]
    found = change(model(friction), model(backlash(1e-3, 1e-5), B_m=(40.0, 0.5)))
    assert found.appeared == ('coupling backlash (1 mrad)',)
    assert found.gone == ('motor friction',)
    assert found.says == 'coupling backlash (1 mrad) appeared; motor friction went'
    back = change(model(), model(friction))
    assert back.says == 'motor friction (coulomb 10.2 N m) appeared'


def test_many_changes_are_counted():
    before = {'J': (0.03, 1e-4), 'B_m': (50.0, 0.1), 'G': (8e3, 1.0), 'K_p': (0.02, 1e-4),
              'K_q': (1.0, 1e-3)}
    names = [name for name in before if name in model().parameters]
    after = {name: (before[name][0] * 1.5, before[name][1]) for name in names}
    found = change(model(**{name: before[name] for name in names}), model(**after))
    assert {move.what for move in found.moved} == set(names)
    assert ('more' in found.says) == (len(names) > 4)
    assert all(abs(a.z) >= abs(b.z) for a, b in zip(found.moved, found.moved[1:], strict=False))


def test_an_unchanged_rig_is_rarely_called_changed():
    """Estimates that scatter as their errors say: the 1 % that is stated, over 400 pairs."""
    rng = np.random.default_rng(5)
    names = {name: p.value for name, p in model().parameters.items()}

    def drawn():
        return model(**{name: (value * (1 + 0.01 * rng.standard_normal()), 0.01 * value)
                        for name, value in names.items()})

    false = sum(bool(change(drawn(), drawn()).moved) for _ in range(400))
    assert false <= 12      # 4 are expected; more than 12 come once in 2000 such tests


def test_quantities():
    assert [quantity(*q) for q in ((1.6e-3, 'rad'), (12.0, 'N m'), (2.5e6, 'Pa'), (0.0, 'm'),
                                   (0.2, '1'), (-3e-6, 'm'))] == [
        '1.6 mrad', '12 N m', '2.5 MPa', '0 m', '0.2', '-3 µm']
