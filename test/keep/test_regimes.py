"""Regimes of a rig, and the evidence in each: on simulated rigs, and its error probabilities."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from store_models import model, PLANT, write

from hydro_twin.commands.main import main
from hydro_twin.keep.duel import Duel, Rules
from hydro_twin.keep.recorded import compare
from hydro_twin.keep.regime_bets import Regimes
from hydro_twin.keep.regimes import Grid, grid_of, Known, regime, seen
from hydro_twin.live.monitor import RISE
from hydro_twin.live.twin import Twin
from hydro_twin.model import Model, Noise
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording, Series
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording

STEP = 0.002
LINES = (5, 9, 17, 31, 44, 61, 80)
SIGNALS = load_signals('load_simulator', [signal.name for signal in PLANT.signals])
TRUE = model()
# Right where the motion is large, and with a dead zone that is not there, which shows where it
# is small; against four times the damping, which shows where the motion is large.
OVERFITTED = [('dead_zone', 'spool', {'width': (1e-6, None)})]
WRONG = {'B_m': (4.0 * TRUE.values['B_m'], None)}


def rig(amplitudes: Sequence[float], seconds: float = 30.0) -> Series:
    """Simulate the rig: a multisine of an amplitude [V] after the other, the shaft likewise."""
    t = np.arange(round(seconds * len(amplitudes) / STEP)) * STEP
    size = np.repeat(amplitudes, round(seconds / STEP))
    phase = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, len(LINES))
    inputs = {'u_m': size * np.sin(2.0 * np.pi * np.outer(t, LINES) / 6.0 + phase).sum(axis=1),
              'theta_d': 0.2 * size * np.sin(2.0 * np.pi * 8.0 * t / 6.0)}
    still = Series(inputs | {'T_g': np.zeros(len(t))}, STEP)
    noise = 0.05 * np.random.default_rng(1).standard_normal(len(t))
    return Series(inputs | {'T_g': TRUE.predictor().free_run(still) + noise}, STEP)


def duel_over(series: Series, champion: Model, challenger: Model, grid: Grid,
              ) -> tuple[Regimes, bool]:
    """Judge two models on a series; returns the evidence, and if one was ever called better."""
    regimes, better = Regimes(grid, PLANT, STEP, 0.02), False
    duel = Duel(*(Twin('', one.predictor(), 'free_run') for one in (champion, challenger)),
                Rules(least=0.0), regimes)
    inputs = np.column_stack([series['u_m'], series['theta_d']])
    for stamp, row, output in zip(series.stamps.tolist(), inputs, series['T_g'].tolist(),
                                  strict=True):
        duel.step(stamp, row, output)
        better = better or duel.outcome == 'better'
    return regimes, better


@pytest.fixture(scope='module')
def moved() -> Series:
    return rig([0.1, 0.01] * 3)


def test_an_effect_overfitted_at_small_motion_is_found_there(moved: Series) -> None:
    grid = grid_of(Recording((moved,)), PLANT)
    regimes, better = duel_over(moved, model(**WRONG), model(OVERFITTED), grid)
    assert better
    worse = regimes.worse(0.01)
    little = f'moving below {grid.movement["T_g"][0]:.3g} N m'
    assert worse
    assert all(little in name for name in worse)
    known = Known('free_run', grid, seen(Recording((moved,)), PLANT, grid), {})
    assert len(known.seen) == 2
    assert set(regimes.pending(known, 0.01)) == set(known.seen) & set(worse)
    # The RMS of each regime is that of the free runs where the series moves little and much.
    for large, names in ((True, known.seen.keys() - worse), (False, set(worse) & set(known.seen))):
        (name,) = names
        for key, one in (('rms_older', model(**WRONG)), ('rms_newer', model(OVERFITTED))):
            error = (moved['T_g'] - one.predictor().free_run(moved)).reshape(6, -1)
            expected = np.sqrt(np.mean(error[0 if large else 1::2, 500:] ** 2))
            assert regimes.record()[name][key] == pytest.approx(expected, rel=0.1)


def test_one_that_is_better_everywhere_holds_everywhere(moved: Series) -> None:
    grid = grid_of(Recording((moved,)), PLANT)
    regimes, better = duel_over(moved, model(**WRONG), TRUE, grid)
    known = Known('free_run', grid, seen(Recording((moved,)), PLANT, grid), {})
    assert better
    assert regimes.worse(0.01) == []
    assert regimes.pending(known, 0.01) == []
    # Where it was not tried it is not known to hold.
    assert regimes.pending(Known('free_run', grid, {'elsewhere': 30.0}, {}), 0.01) == ['elsewhere']


def test_the_regime_is_told_by_the_level_and_by_what_the_measured_signals_move() -> None:
    t = np.arange(5000) * STEP
    columns = {'u_m': t, 'theta_d': 1e-3 * np.sin(2 * np.pi * 5 * t),
               'T_g': 40.0 * np.sin(2 * np.pi * 2 * t)}
    grid = grid_of(Recording((Series(columns, STEP),)), PLANT)
    assert grid.level == pytest.approx((-80 / 6, 80 / 6), rel=0.02)
    assert grid.movement == {'T_g': pytest.approx((4 / math.sqrt(2), 40 / 3 / math.sqrt(2))),
                             'theta_d': pytest.approx((1e-4 / math.sqrt(2),
                                                       1e-3 / 3 / math.sqrt(2)))}
    fixed = Grid((-10.0, 10.0), {'T_g': (1.0, 3.0), 'theta_d': (1e-4, 3e-4)})
    wave = np.tile([1.0, -1.0], 250)
    for level, motion, says in (
            (0.0, 2.0, 'T_g -10 N m to 10 N m, moving 1 N m to 3 N m; theta_d moving above 300'),
            (50.0, 0.0, 'T_g above 10 N m, moving below 1 N m; theta_d moving above 300 µrad'),
            (-50.0, 9.0, 'T_g below -10 N m, moving above 3 N m; theta_d moving above 300')):
        window = np.stack([level + motion * wave, 1e-3 * wave])
        assert regime(fixed, PLANT, window).startswith(says)


def judged(rng: np.random.Generator, memory: float, ratio: float) -> tuple[bool, bool]:
    """Judge a model whose mean square is so many times that of another, on 600 s of a rig.

    At 10 Hz, in five regimes that take turns; the residuals of the two share half of their
    variance, and are forgotten in a time [s]. All is looked at after each window.

    Returns:
        Whether any regime was ever called worse, and whether it was ever taken to hold in the
        first, at 5 % each.
    """
    regimes = Regimes(Grid((0.3, 0.6), {'opening': (0.1, 0.2)}), plant_named('valve_servo'), 0.1,
                      0.0)
    pole = math.exp(-0.1 / memory) if memory else 0.0
    common, ours, theirs = lfilter([math.sqrt(1.0 - pole * pole)], [1.0, -pole],
                                   rng.standard_normal((3, 7000)))[:, 1000:]
    block = math.ceil(10.0 * (1.0 + pole) / (1.0 - pole))
    first = Known('free_run', regimes.grid, {'opening below 0.3, moving below 0.1': 60.0}, {})
    worse = holds = False
    for k in range(6000):
        place = k // 320 % 5
        opening = (0.1, 0.5, 0.9)[place % 3] + (0.15 if place > 2 else 0.0) * (-1.0) ** k
        regimes.add(np.zeros(1), opening, block, float((common[k] + ours[k]) ** 2),
                    float(ratio * (common[k] + theirs[k]) ** 2))
        if k % 16 == 15:
            worse = worse or bool(regimes.worse(0.05))
            holds = holds or not regimes.pending(first, 0.05)
    assert len(regimes.found) == 5
    return worse, holds


def by_chance(runs: int) -> float:
    """Bound how many of so many runs end in an error of 5 %, by three standard deviations."""
    return 0.05 * runs + 3.0 * math.sqrt(0.05 * 0.95 * runs)


@pytest.mark.slow
@pytest.mark.parametrize('memory', [0.0, 0.2])
def test_on_an_unchanged_rig_a_regime_is_rarely_called_worse(memory: float) -> None:
    rng = np.random.default_rng(2)
    false = sum(judged(rng, memory, 1.0)[0] for _ in range(100))
    print(f'memory {memory} s: {false} of 100')
    assert false <= by_chance(100)
    assert judged(rng, memory, 4.0)[0]


@pytest.mark.slow
def test_one_that_does_not_hold_is_rarely_taken_to_hold() -> None:
    rng = np.random.default_rng(3)
    false = sum(judged(rng, 0.0, RISE ** 2)[1] for _ in range(100))
    print(f'{false} of 100')
    assert false <= by_chance(100)
    assert judged(rng, 0.0, 0.5)[1]


def test_a_model_that_diverges_in_a_regime_is_worse_there(moved: Series) -> None:
    grid = Grid((-5.0, 5.0), {'T_g': (1.0, 3.0), 'theta_d': (1e-3, 3e-3)})
    regimes = Regimes(grid, PLANT, STEP, 0.02)
    for _ in range(12):
        for _ in range(100):
            regimes.add(np.zeros(2), 0.0, 125, 1.0, 1.0)
        regimes.note_divergence(older=False, newer=True)
    (name,) = regimes.worse(0.01)
    assert regimes.compared(name) == 'it diverges'


def test_models_that_were_asked_for_the_observer_are_compared_in_one_mode() -> None:
    """One of them lacks its noise, so it runs one_step: so must the other."""
    series = rig([0.1], 16.0)
    noise = Noise(1.0, {'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 0.1},
                  {'x_v': 1e-5, 'p_L': 1e6, 'omega_j': 0.1, 'theta_j': 0.01})
    champion = Twin('', replace(TRUE, noise=noise).predictor(), 'observer')
    known, regimes = compare(champion, Twin('', TRUE.predictor(), 'one_step'),
                             Recording((series,)), Recording((series,)))
    assert known.mode == 'one_step'
    assert any(one.samples for one in regimes.found.values())
    for one in regimes.found.values():
        assert one.totals[0] == one.totals[1]


@pytest.mark.slow
def test_the_verb_compares_on_recordings_that_the_challenger_was_not_made_from(
        tmp_path: Path, moved: Series, capsys: pytest.CaptureFixture[str]) -> None:
    write_recording(tmp_path / 'new', [rig([0.1])], SIGNALS)
    write_recording(tmp_path / 'earlier', [moved], SIGNALS)
    words = ['regimes', str(tmp_path / 'new'), str(tmp_path / 'earlier'),
             '--model', str(write(tmp_path / 'champion.yaml', **WRONG)),
             '--challenger', str(write(tmp_path / 'challenger.yaml', OVERFITTED))]
    assert main([*words, '--fitted', str(tmp_path / 'new'), '--json']) == 0
    said = json.loads(capsys.readouterr().out)
    much, little = sorted(said['seen'], key=said['seen'].__getitem__, reverse=True)
    assert said['seen'][much] == pytest.approx(120.0, abs=4.0)     # in both recordings
    assert said['holds'][much] > 100.0 > 1.0 > said['holds'][little]
    assert said['regimes'][much]['seconds'] < 90.0                 # in the earlier one
    assert main(words) == 0
    assert 'evidence that it holds' in ' '.join(capsys.readouterr().out.split())
    assert main([*words, '--fitted', 'other']) == 2
    assert capsys.readouterr().err == 'hydro-twin regimes: --fitted other: not one of BAG...\n'
