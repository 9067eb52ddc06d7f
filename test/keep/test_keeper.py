"""The loop without ROS: from an event to a promotion, and what else may happen on the way."""
from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path
import re

from keep_loop import Loop
import pytest
from store_models import PLANT, write

from hydro_twin.errors import UserError
from hydro_twin.keep import keeper as module
from hydro_twin.keep.duel import in_one_mode
from hydro_twin.keep.limits import check_names, parse
from hydro_twin.keep.ring import SECOND
from hydro_twin.keep.settings import SETTINGS
from hydro_twin.live.models import Choice, load_twin
from hydro_twin.model import Noise, read_model, write_model
from hydro_twin.recording.digest import source_of
from hydro_twin.store.history import rows
from hydro_twin.store.lineage import recordings

REFIT = {'event': 'refit', 'model': '', 'rms': 3.0, 'reference_rms': 1.0}


def test_an_event_becomes_a_promotion_that_is_confirmed(loop: Loop) -> None:
    loop.tick(3)
    assert loop.champion() == '0001'        # what the twin ran
    assert loop.said() == 'idle'
    loop.keeper.refit(loop.now, REFIT)
    loop.tick()
    assert 'capturing, 4 s to come' in loop.said()
    loop.until(lambda: 'traced' in loop.events())
    assert loop.keeper.store.challenger.name == '0002'
    assert 'judging challenger 0002 against 0001' in loop.said()
    loop.judged(4.0, 1.0)
    assert loop.champion() == '0002'
    (about,) = [about for event, about in loop.announced if event == 'promoted']
    assert re.fullmatch(r'motor friction \(coulomb 10 N m\) appeared since \d\d:\d\d UTC',
                        str(about['changed']))
    assert about['evidence']['e_value'] > 100.0
    loop.tick(2)
    assert loop.keeper.twin.runs['path'].endswith('models/0002/model.yaml')
    loop.judged(1.0, 4.0)       # the champion against its predecessor
    assert loop.events()[-1] == 'confirmed'
    assert loop.said() == 'idle'
    record = loop.keeper.store.version('0002').record
    assert record['bag']['sha256'] == source_of(
        loop.folder / 'store' / record['bag']['path']).sha256
    assert [row.captured for row in rows(loop.keeper.store)] == ['', record['bag']['why'][0]]
    assert record['bag']['why'] == ['refit: the residual is 3, reference 1']


def test_a_champion_that_does_worse_goes_back(loop: Loop) -> None:
    loop.keeper.ask(loop.now, 'a test')
    loop.judged(4.0, 1.0)
    assert loop.champion() == '0002'
    loop.judged(4.0, 1.0)       # now the predecessor is the better one
    assert loop.champion() == '0001'
    loop.tick(2)
    assert loop.keeper.twin.runs['path'].endswith('models/0001/model.yaml')
    last = loop.keeper.store.version('0002').decisions[-1]
    assert (last['what'], last['why']) == ('rolled back', 'its predecessor is better')


@pytest.mark.parametrize(('ours', 'theirs', 'why'), [
    (1.0, 4.0, 'its residual is larger'), (1.0, 1.0, 'no better within 62 s')])
def test_a_challenger_that_is_no_better_is_discarded(loop: Loop, ours, theirs, why) -> None:
    loop.keeper.ask(loop.now, 'a test')
    loop.judged(ours, theirs, 62.0)
    assert loop.champion() == '0001'
    assert loop.keeper.store.challenger is None
    last = loop.keeper.store.version('0002').decisions[-1]
    assert last['what'] == 'discarded'
    assert last['why'].startswith(why)


@pytest.mark.parametrize(('most', 'champion'), [(5.0, '0001'), (20.0, '0002')])
def test_beyond_its_limits_a_model_is_only_recommended(loop: Loop, most, champion) -> None:
    loop.values['limits'] = (f'friction@motor:coulomb=0..{most:g}', 'rate@spool:limit=0..1')
    loop.tick(2)
    loop.keeper.ask(loop.now, 'a test')
    loop.judged(4.0, 1.0)
    assert loop.champion() == champion
    if most < 10.0:
        event, about = loop.announced[-1]
        assert event == 'recommended'
        assert about['why'] == 'friction@motor:coulomb 10 is not within 0 to 5'
        assert loop.keeper.store.version('0002').decisions[-1]['why'] == about['why']
        assert loop.keeper.promote('me') == 'version 0002 is the champion'


def test_a_limit_of_no_parameter_is_refused_and_leaves_no_model_to_the_evidence(loop: Loop,
                                                                                ) -> None:
    for limits in (['B_m=1..2', 'D_m=0..1'], ['friction@motor:coulomb=0..20'], []):
        check_names(parse(limits), PLANT)
    with pytest.raises(UserError, match='no parameter B_mm; load_simulator has V_m, J, K_p'):
        check_names(parse(['B_m=1..2', 'B_mm=10..100']), PLANT)
    loop.values['limits'] = ('B_mm=10..100',)
    loop.tick(2)
    loop.keeper.ask(loop.now, 'a test')
    loop.judged(4.0, 1.0)
    assert (loop.champion(), loop.events()[-1]) == ('0001', 'recommended')
    assert 'no parameter B_mm' in loop.announced[-1][1]['why']


@pytest.mark.parametrize('entry', ['B_m', 'B_m=1', '=1..2', 'B_m=2..1', 'B_m=a..b', 'B_m=1..2..3'])
def test_limits_that_are_none_are_refused(entry: str) -> None:
    assert parse(['', 'B_m=-1..2e3']) == {'B_m': (-1.0, 2000.0)}
    with pytest.raises(UserError, match=r'LOW\.\.HIGH is needed'):
        parse([entry])
    (setting,) = [s for s in SETTINGS if s.name == 'limits']
    assert 'LOW..HIGH is needed' in setting.objection([entry])


def test_a_capture_is_made_every_so_often(loop: Loop) -> None:
    loop.values['every'], loop.finds = 50.0, None
    loop.tick(50)
    assert 'captured' not in loop.events()
    loop.until(lambda: 'failed' in loop.events())
    assert [about['why'] for event, about in loop.announced if event == 'captured'] == [
        ['every 50 s']]
    loop.tick(60)
    loop.until(lambda: loop.events().count('captured') == 2)


@pytest.mark.parametrize('policy', ['observe', 'ask'])
def test_without_auto_a_person_promotes(loop: Loop, policy: str) -> None:
    loop.values['policy'] = policy
    loop.tick(2)
    loop.keeper.ask(loop.now, 'a test')
    loop.judged(4.0, 1.0)
    assert (loop.champion(), loop.events()[-1]) == ('0001', 'recommended')
    loop.tick()
    assert 'challenger 0002 waits to be promoted' in loop.said()
    if policy == 'observe':
        with pytest.raises(UserError, match='policy is observe'):
            loop.keeper.promote('me')
        with pytest.raises(UserError, match='policy is observe'):
            loop.keeper.roll_back('me')
        # By the verb, the store is as the person wants it; the twin is left alone.
        loop.keeper.store.promote('challenger', 'me')
        loop.tick(30)
        assert loop.keeper.twin.runs['path'] == str(loop.first)
        assert 'the twin does not run the champion' in loop.said()
        return
    assert loop.keeper.promote('me') == 'version 0002 is the champion'
    loop.tick(2)
    assert loop.keeper.twin.runs['path'].endswith('models/0002/model.yaml')
    assert loop.keeper.roll_back('me') == 'version 0001 is the champion again'
    loop.tick(2)
    assert loop.keeper.twin.runs['path'].endswith('models/0001/model.yaml')


def test_a_trace_that_fails_is_one_line_and_the_next_event_is_not_lost(loop: Loop) -> None:
    found, loop.finds = loop.finds, None
    loop.tick(2)
    loop.keeper.ask(loop.now, 'one')
    loop.until(lambda: 'failed' in loop.events())
    assert 'it holds no 3 samples in a row' in loop.said()
    assert '\n' not in loop.said()
    (outcome,) = (loop.folder / 'store' / 'captures').glob('*/outcome.json')
    assert json.loads(outcome.read_text())['outcome'].startswith('failed')
    loop.finds = found
    loop.keeper.ask(loop.now, 'two')
    loop.until(lambda: loop.keeper.judge.on_trial)
    assert 'it holds no' not in loop.said()
    loop.keeper.ask(loop.now, 'three')      # while one is judged
    loop.until(lambda: len(loop.keeper.waiting) == 1)
    assert '1 captures to trace' in loop.said()
    loop.judged(1.0, 4.0)
    loop.until(lambda: loop.events().count('traced') == 2)
    assert loop.keeper.store.challenger.name == '0003'


def test_where_the_champion_changes_during_a_trace_it_is_traced_again(loop: Loop) -> None:
    loop.tick(2)
    store = loop.keeper.store
    other = store.enter(write(loop.folder / 'other.yaml', J=(0.1, 0.001)), 'me')
    trace = loop._trace

    def meanwhile(*arguments: object) -> Path:
        if store.champion.name == '0001':
            store.promote(other.name, 'me')
        return trace(*arguments)

    loop.monkeypatch.setattr(module, 'trace', meanwhile)
    loop.keeper.ask(loop.now, 'a test')
    loop.until(lambda: 'traced' in loop.events())
    assert loop.events().count('tracing') == 2
    assert [version.name for version in store.versions()] == ['0001', '0002', '0003']
    assert store.challenger.parent == loop.keeper.judge.pair.champion.name == '0002'


def test_a_model_without_its_noise_and_the_observer_are_judged_in_one_mode(loop: Loop) -> None:
    loop.values['mode'] = 'observer'
    noise = Noise(1.0, {'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 0.1},
                  {'x_v': 1e-5, 'p_L': 1e6, 'omega_j': 0.1, 'theta_j': 0.01})
    write_model(replace(read_model(loop.first), noise=noise), loop.first)
    loop.runs(loop.first)
    loop.tick(2)
    judge = loop.keeper.judge
    judge.challenge(loop.keeper.champion, loop.keeper.store.enter(loop.finds, 'me'))
    loop.until(lambda: judge.duel is not None)
    assert judge.duel.champion.mode == judge.duel.challenger.mode == 'one_step'
    assert judge.duel.champion.about['mode'] == 'one_step'
    one, other = (load_twin(Choice('', loop.first), 'observer') for _ in range(2))
    assert in_one_mode(one, other) == (one, other)


def test_a_predecessor_that_cannot_be_run_is_said(loop: Loop) -> None:
    loop.tick(2)
    loop.keeper.ask(loop.now, 'a test')
    loop.judged(4.0, 1.0)
    assert loop.champion() == '0002'
    loop.keeper.store.version('0001').model_file.write_text('damaged')
    loop.until(lambda: 'fault' in loop.events())
    (says,) = [about['says'] for event, about in loop.announced if event == 'fault']
    assert says.startswith('version 0002 is not judged against its predecessor 0001: ')


def test_after_a_restart_it_goes_on(loop: Loop) -> None:
    loop.tick(2)
    loop.keeper.ask(loop.now, 'a test')
    loop.until(lambda: loop.keeper.judge.on_trial)
    loop.keeper.ask(loop.now, 'another')
    loop.until(lambda: bool(loop.keeper.waiting))
    loop.start()                            # as after a kill, while a challenger is judged
    (waits,) = loop.keeper.waiting
    assert waits.why == ['another']
    loop.finds = None                       # so that nothing comes of it
    loop.runs(loop.first)
    loop.judged(4.0, 1.0)
    assert loop.champion() == '0002'
    loop.until(lambda: 'failed' in loop.events())
    loop.start()
    loop.runs(loop.first)                   # a twin that was started with its old model
    loop.tick(3)
    assert loop.keeper.twin.runs['path'].endswith('models/0002/model.yaml')
    assert 'judging champion 0002 against its predecessor 0001' in loop.said()


def test_a_model_that_the_twin_refuses_is_taken_back(loop: Loop) -> None:
    loop.tick(2)
    loop.refusal = 'no section `observer`'
    loop.keeper.ask(loop.now, 'a test')
    loop.judged(4.0, 1.0)
    loop.tick(2)
    assert loop.champion() == '0001'
    assert 'refuses version 0002: no section' in loop.said()


def test_where_the_model_still_does_not_hold_another_capture_follows(loop: Loop) -> None:
    loop.values['again'] = 100.0
    loop.finds = None
    loop.tick(2)
    loop.keeper.refit(loop.now, REFIT)
    loop.until(lambda: 'failed' in loop.events())
    loop.tick(90)
    assert loop.events().count('captured') == 1
    loop.until(lambda: loop.events().count('failed') == 2)
    loop.values['again'] = 0.0
    loop.tick(300)
    assert loop.events().count('captured') == 2


def test_a_stretch_that_says_too_little_is_followed_by_a_longer_one(loop: Loop) -> None:
    loop.lacks = 'J not at all: move u_m near 8 Hz'
    loop.values |= {'before': 30.0, 'after': 5.0}
    loop.tick(2)
    loop.keeper.refit(loop.now, REFIT | {'settled': 0})
    loop.until(lambda: 'not_enough' in loop.events())
    loop.tick()
    assert 'the last stretch was not enough: J not at all' in loop.said()
    assert not loop.keeper.fault
    assert 29.0 <= loop.keeper.capture.left(loop.now) <= 30.0
    loop.lacks = ''
    loop.until(lambda: 'traced' in loop.events())
    assert 'not enough' not in loop.said()
    assert loop.events().count('captured') == 2
    # Without an event of the twin it is announced, and nothing more.
    loop.judged(4.0, 1.0)
    loop.lacks = 'all is at rest'
    loop.keeper.ask(loop.now, 'a person')
    loop.until(lambda: loop.events().count('not_enough') == 2)
    loop.tick(100)
    assert loop.events().count('captured') == 3


def test_a_trace_has_the_recordings_that_the_champion_came_from(loop: Loop) -> None:
    loop.values |= {'captures': 1, 'recordings': 2}
    loop.tick(2)
    bags = []
    for count in range(1, 5):
        loop.keeper.ask(loop.now, 'a person')
        loop.until(lambda count=count: loop.events().count('traced') == count)
        loop.judged(4.0, 1.0)
        bags.append(loop.keeper.store.path / loop.keeper.store.champion.record['bag']['path'])
    # The newest two, the newest first; none of them was counted out, and the oldest was.
    assert loop.earlier == [[], bags[:1], [bags[1], bags[0]], [bags[2], bags[1]]]
    assert [bag.exists() for bag in bags] == [False, True, True, True]
    # One that was changed since is not what the champion came from.
    next(bags[3].iterdir()).write_bytes(b'')
    assert recordings(loop.keeper.store, loop.keeper.store.champion, 2) == [bags[2], bags[1]]
    assert recordings(loop.keeper.store, loop.keeper.store.champion, 0) == []


def test_a_store_that_is_damaged_meanwhile_is_told_and_survived(loop: Loop) -> None:
    loop.tick(2)
    alias = loop.folder / 'store' / 'champion'
    alias.write_text('nonsense')
    loop.tick(2)
    assert loop.said().endswith('is no version of this store')
    assert loop.events().count('fault') == 1
    alias.write_text('0001\n')
    loop.tick(2)
    assert (loop.champion(), loop.said()) == ('0001', 'idle')


def test_the_stretch_begins_when_the_rise_has_settled(loop: Loop) -> None:
    for k in range(100):
        loop.keeper.note_time(loop.now + k * SECOND, 5000 * SECOND + 3 * k * SECOND)
    now = loop.now + 100 * SECOND
    loop.keeper.refit(now, REFIT | {'settled': 5000 * SECOND + 150 * SECOND})
    assert loop.keeper.capture.wanted.begin == loop.now + 50 * SECOND
    # An alarm in the first batch of the rise: what comes from now on.
    loop.keeper.capture.wanted = None
    loop.keeper.refit(now, REFIT | {'settled': 9000 * SECOND})
    again = loop.keeper.capture.wanted
    assert again is not None
    assert again.begin == now
    loop.keeper.capture.wanted = None
    loop.keeper.refit(now, REFIT | {'model': 'beside'})
    assert loop.keeper.capture.wanted is None
