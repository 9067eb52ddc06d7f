"""What earlier recordings say is kept where it still holds, and only there."""
from __future__ import annotations

import json
import math

import pytest
from traced_rig import PLANT, record, VALUES

from hydro_twin.commands.main import main
from hydro_twin.fitting.parts import parts_of
from hydro_twin.fitting.unknowns import get, label
from hydro_twin.inference.memory import combine_with_earlier, named
from hydro_twin.inference.search import search
from hydro_twin.inference.starts import with_effect
from hydro_twin.model import Model, place, read_model, write_model
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording

FRICTION = ('friction', 'motor', {'coulomb': 6.0})
QUIET = {'seed': 5, 'count': 1, 'duration': 2.5, 'amplitude': 0.03}    # says little by itself
TRUE = Model(PLANT, VALUES, 0.002, substeps=2)


@pytest.fixture(scope='module')
def earlier():
    return parts_of(record(seed=1, count=2, duration=3.0), PLANT)


@pytest.fixture(scope='module')
def champion(earlier):
    """Fit what the rig was."""
    return search(TRUE, earlier, 10).candidate


def off(candidate, names):
    """Say how far parameters are from those that the rig has, as factors."""
    return math.hypot(*(math.log(candidate.values[name] / VALUES[name]) for name in names))


def test_what_did_not_change_is_known_from_both(earlier, champion):
    names = ('V_m', 'K_p', 'K_ce', 'B_m')
    distance = [0.0, 0.0]
    for seed in range(5, 10):
        parts = parts_of(record(FRICTION, **QUIET | {'seed': seed}), PLANT)
        alone = search(with_effect(champion, place(*FRICTION, PLANT)), parts, 30)
        together = combine_with_earlier(alone, parts, champion, earlier)
        assert together.moved == ()
        known, by_itself = together.known.std_error, alone.identifiability().std_error
        for name in names:
            assert known[name] < 0.9 * by_itself[name]
            # The errors are those of the fit to all: the true value is within them.
            assert off(together.fit.candidate, [name]) < 4 * known[name]
        assert together.fit.candidate.effects[0].named['coulomb'] == pytest.approx(6.0, rel=0.05)
        distance = [one + off(fit.candidate, names) ** 2
                    for one, fit in zip(distance, (alone, together.fit), strict=True)]
    assert distance[1] < 0.5 * distance[0]


def test_what_moved_is_as_the_new_recording_has_it(earlier, champion):
    values = VALUES | {'K_p': 1.5 * VALUES['K_p']}
    parts = parts_of(record(seed=6, count=2, values=values), PLANT)
    alone = search(champion, parts, 30)
    together = combine_with_earlier(alone, parts, champion, earlier)
    assert 'K_p' in [named(alone.candidate, unknown) for unknown in together.moved]
    assert together.fit.candidate.values['K_p'] == pytest.approx(values['K_p'], rel=0.1)


def test_an_effect_of_the_model_before_is_shared_one_of_the_trace_is_not(earlier, champion):
    """What a trace added, the earlier recordings say nothing of."""
    parts = parts_of(record(FRICTION, **QUIET), PLANT)
    rubs = search(with_effect(champion, place(*FRICTION, PLANT)), parts, 10)
    twice = combine_with_earlier(rubs, parts, rubs.candidate, parts)
    (coulomb,) = [u for u in rubs.unknowns if label(u) == '0:coulomb']
    once = rubs.identifiability().std_error['0:coulomb']
    # The same recording twice: the same values, and errors smaller by the root of two.
    assert twice.known.std_error['0:coulomb'] == pytest.approx(once / math.sqrt(2.0), rel=0.05)
    assert get(twice.fit.candidate, coulomb) == pytest.approx(get(rubs.candidate, coulomb),
                                                              rel=0.01)
    added = combine_with_earlier(rubs, parts, rubs.candidate.without(0), parts)
    assert added.known.std_error['0:coulomb'] > 1.1 * once / math.sqrt(2.0)
    assert named(rubs.candidate, coulomb) == 'coulomb of the friction'


@pytest.mark.slow
def test_the_verb_keeps_what_earlier_bags_say(tmp_path, capsys, champion):
    """A trace of a short new recording, with and without the one that the model came from."""
    old, new = tmp_path / 'old', tmp_path / 'new'
    config = tmp_path / 'model.yaml'
    signals = load_signals(PLANT.name, [signal.name for signal in PLANT.signals])
    write_recording(old, record(seed=1, count=2, duration=4.0).series, signals)
    write_recording(new, record(FRICTION, **QUIET | {'duration': 4.0}).series, signals)
    write_model(champion, config)
    models: list[Model] = []
    for name, words in (('alone', ()), ('both', ('--earlier', str(old)))):
        assert main(['trace', str(new), '--plant', PLANT.name, '--model', str(config), *words,
                     '-o', str(tmp_path / name), '--json']) == 0
        report = json.loads(capsys.readouterr().out)
        assert [effect['id'] for effect in report['effects']] == ['friction']
        models.append(read_model(tmp_path / name / 'model.yaml'))
    memory = report['memory']
    assert memory['used']
    assert memory['bags'] == [str(old)]
    # The rig did not rub then.
    assert memory['held_out']['before'] == pytest.approx(0.5, rel=0.1)
    assert memory['held_out']['after'] > 2.0
    assert 'on the earlier ones' in memory['says']
    alone, both = (model.parameters['K_ce'].std_error for model in models)
    assert both < 0.7 * alone


def test_earlier_recordings_need_a_model_that_came_from_them(tmp_path, capsys):
    assert main(['trace', 'new', '--plant', PLANT.name, '--earlier', 'old', '-o',
                 str(tmp_path / 'out')]) == 2
    assert '--earlier is for the recordings that a --model came from' in capsys.readouterr().err
