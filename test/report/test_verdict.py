"""What may be said of a trace."""
from dataclasses import replace

import pytest
from trace_by_hand import trace

from hydro_twin.report.summary import remainder_sentence
from hydro_twin.residual.verdict import judge


@pytest.fixture(scope='module')
def rubbing():
    return trace('load_simulator')


def test_an_error_of_many_times_the_noise_is_not_noise(rubbing):
    assert judge(rubbing).kind == 'effect_found'
    nothing = replace(rubbing, findings=())
    assert judge(nothing).kind == 'nothing_missing'
    loud = replace(nothing, floor=nothing.after.error / 6.0)
    assert judge(loud).kind == 'unexplained'
    assert '6 times as large as the noise' in remainder_sentence(loud)


@pytest.mark.parametrize('unseen', [1.5, float('nan')])
def test_a_model_that_fails_elsewhere_lacks_something(rubbing, unseen):
    nothing = replace(rubbing, findings=())
    assert judge(replace(nothing, unseen=unseen * nothing.after.error)).kind == 'unexplained'
