"""What the loop makes of the evidence by regime: refuse, wait, leave it to a person, go back."""
from __future__ import annotations

from dataclasses import replace
import json

from keep_loop import Loop
import numpy as np
import pytest

from hydro_twin.keep.regimes import Grid, Known

GRID = Grid((-5.0, 5.0), {'T_g': (1.0, 3.0), 'theta_d': (1e-3, 3e-3)})
LITTLE = 'T_g -5 N m to 5 N m, moving below 1 N m; theta_d moving below 1 mrad'
MUCH = 'T_g -5 N m to 5 N m, moving above 3 N m; theta_d moving below 1 mrad'
KNOWN = Known('free_run', GRID, {LITTLE: 60.0, MUCH: 60.0}, {})
AT_REST = np.zeros(2)


def run(loop: Loop, motion: float, older: float, newer: float, seconds: float) -> None:
    """Have the output swing by so much, and two models miss it by so much (mean square).

    The older one is the champion of a trial and the predecessor on probation.
    """
    loop.tick()       # so that a new champion is noticed
    loop.until(lambda: loop.keeper.judge.duel is not None)
    judge = loop.keeper.judge
    pair = (older, newer) if judge.on_trial else (newer, older)
    for k in range(round(seconds * 500)):
        if judge.duel is None:
            return
        judge.duel.take(*(one * (1 + k % 3) for one in pair), AT_REST,
                        motion if k % 2 else -motion)
        if k % 500 == 499:
            loop.tick()
    loop.tick()


@pytest.fixture
def tried(loop: Loop) -> Loop:
    """Have a challenger on trial that was traced beside recordings of two regimes."""
    loop.known = KNOWN
    loop.tick(2)
    loop.keeper.ask(loop.now, 'a test')
    return loop


def last(loop: Loop, version: str = '0002') -> dict[str, object]:
    decided: dict[str, object] = loop.keeper.store.version(version).decisions[-1]
    return decided


def test_better_overall_and_worse_in_a_regime_is_refused_and_the_regime_named(tried: Loop) -> None:
    run(tried, 10.0, 16.0, 1.0, 30.0)
    assert f'still to be seen: {LITTLE}' in tried.said()
    duel = tried.keeper.judge.duel
    assert duel is not None
    assert duel.outcome == 'better'           # as far as the whole goes
    run(tried, 0.2, 1.0, 4.0, 30.0)
    assert tried.champion() == '0001'
    assert last(tried)['what'] == 'discarded'
    assert last(tried)['why'] == (
        f'it is worse than the champion at {LITTLE} (RMS 2.83 N m against 1.41 N m)')
    (about,) = [about for event, about in tried.announced if event == 'discarded']
    assert about['why'] == last(tried)['why']
    found = about['evidence']['regimes']
    assert found[LITTLE]['worse'] > 200.0 > 1.0 > found[MUCH]['worse']
    json.dumps(found, allow_nan=False)


def test_better_everywhere_is_promoted_once_both_were_visited(tried: Loop) -> None:
    run(tried, 10.0, 16.0, 1.0, 30.0)
    assert tried.champion() == '0001'
    run(tried, 0.2, 16.0, 1.0, 30.0)
    assert tried.champion() == '0002'


def test_after_a_restart_the_same_regimes_are_asked_for(tried: Loop) -> None:
    run(tried, 10.0, 16.0, 1.0, 20.0)
    tried.start()
    tried.runs(tried.first)
    run(tried, 10.0, 16.0, 1.0, 30.0)
    assert f'still to be seen: {LITTLE}' in tried.said()
    assert tried.champion() == '0001'


@pytest.mark.parametrize(('holds', 'mode'), [
    (99.0, 'free_run'), (101.0, 'free_run'), (101.0, 'one_step')])
def test_a_regime_that_is_not_visited_is_judged_on_recordings(loop: Loop, holds: float,
                                                              mode: str) -> None:
    loop.known = replace(KNOWN, mode=mode, holds={LITTLE: holds})
    enough = holds > 100.0 and mode == 'free_run'
    loop.tick(2)
    loop.keeper.ask(loop.now, 'a test')
    run(loop, 10.0, 16.0, 1.0, 50.0)
    assert loop.champion() == ('0002' if enough else '0001')
    run(loop, 10.0, 16.0, 1.0, 15.0)
    if not enough:       # the trial is over: a person decides
        assert last(loop)['what'] == 'recommended'
        assert last(loop)['why'] == f'not judged at {LITTLE}'
        assert loop.keeper.promote('me') == 'version 0002 is the champion'


def test_recordings_say_nothing_against_another_champion(loop: Loop) -> None:
    loop.known = replace(KNOWN, holds={LITTLE: 1e6})
    loop.tick(2)
    loop.keeper.ask(loop.now, 'a test')
    loop.until(lambda: loop.keeper.judge.on_trial)
    store = loop.keeper.store
    store.promote(store.enter(loop.first, 'me').name, 'me')
    run(loop, 10.0, 16.0, 1.0, 30.0)
    assert 'challenger 0002 against 0003: 30 s, ' in loop.said()
    assert f'still to be seen: {LITTLE}' in loop.said()


def test_a_champion_that_is_worse_in_a_regime_goes_back(tried: Loop) -> None:
    run(tried, 10.0, 16.0, 1.0, 30.0)
    assert tried.keeper.promote('me') == 'version 0002 is the champion'
    run(tried, 10.0, 16.0, 1.0, 30.0)
    assert tried.champion() == '0002'
    assert 'confirmed' not in tried.events()      # before it was seen where it moves little
    run(tried, 0.2, 1.0, 4.0, 40.0)
    assert tried.champion() == '0001'
    assert last(tried)['what'] == 'rolled back'
    assert str(last(tried)['why']).startswith(f'it is worse than its predecessor at {LITTLE}')


def test_a_version_without_known_regimes_is_judged_as_a_whole(loop: Loop) -> None:
    loop.keeper.ask(loop.now, 'a test')
    run(loop, 10.0, 16.0, 1.0, 30.0)
    assert loop.champion() == '0002'
    assert 'regimes' not in last(loop)['evidence']      # type: ignore[operator]


def test_regimes_that_cannot_be_read_are_one_line(loop: Loop) -> None:
    loop.known = KNOWN
    loop.values['trial'] = 1e6
    loop.tick(2)
    loop.keeper.ask(loop.now, 'a test')
    loop.until(lambda: loop.keeper.judge.on_trial)
    folder = loop.keeper.store.version('0002').folder
    (folder / 'regimes.json').write_text('{"grid": 1}')
    loop.start()
    loop.runs(loop.first)
    loop.until(lambda: last(loop)['what'] == 'discarded')
    assert 'regimes.json: damaged' in str(last(loop)['why'])
    assert loop.champion() == '0001'
