"""How stated probabilities are counted."""
import numpy as np
import pytest

from benchmarks.tracing.calibrate import calibration_error, report, Statement, statements


def line(kind, there, named, nothing=0.0, law_unknown=0.15, shows=1.0, **more):
    return {'kind': kind, 'effects': there, 'shows': shows, **more, 'report': {
        'verdict': 'effect_found' if named else 'unexplained', 'ambiguous': [],
        'nothing': nothing, 'law_unknown': law_unknown,
        'effects': [{'id': name, 'probability': p, 'certain': p >= 0.99}
                    for name, p in named.items()]}}


def test_what_a_report_states_is_held_against_the_rig():
    found = statements([
        line('single', ['friction'], {'friction': 0.9}),
        line('outside', ['soft_flow'], {'orifice': 0.8}),
        line('outside', ['leak_drift'], {'drift': 0.8}),
        line('none', [], {}, 0.85, 0.15),
        line('cylinder', ['dead_zone'], {'delay': 0.7, 'dead_zone': 0.6}, also=['delay'])])
    assert found == [
        Statement('effect', 0.9, True), Statement('law_unknown', 0.15, False),
        Statement('effect', 0.8, False), Statement('law_unknown', 0.15, True),
        Statement('effect', 0.8, True), Statement('law_unknown', 0.15, False),
        Statement('nothing', 0.85, True), Statement('law_unknown', 0.15, False),
        Statement('effect', 0.6, True), Statement('law_unknown', 0.15, False)]


@pytest.mark.parametrize('stated', [0.6, 0.85])
@pytest.mark.parametrize('true', [0.6, 0.85])
def test_the_calibration_error_is_the_distance_of_stated_and_true(stated, true):
    drawn = np.random.default_rng(0).random(20_000) < true
    some = [Statement('effect', stated, bool(one)) for one in drawn]
    assert calibration_error(some) == pytest.approx(abs(stated - true), abs=0.01)


def test_the_table_has_a_row_for_each_group():
    text = report([line('single', ['friction'], {'friction': p}) for p in (0.4, 0.85, 0.995)])
    assert '| 0.25 to 0.5 | 0.400 | 1.000 | 1 |' in text
    assert '| 0.8 to 0.9 | 0.850 | 1.000 | 1 |' in text
    assert '| 0.99 to 1 | 0.995 | 1.000 | 1 |' in text
    assert '| law unknown 0.150 | 0.000 | 3 |' in text
