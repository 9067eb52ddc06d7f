"""The test by betting: its error probability, its power, and the duel that feeds it."""
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from hydro_twin.keep.betting import Bet, least_gain, relative_gain, SHARES
from hydro_twin.keep.duel import autocorrelation_time, Duel, Rules

RATE = 500.0


def twin():
    """Stand in for a twin, where the residuals are given."""
    return SimpleNamespace(predictor=SimpleNamespace(sample_time=1 / RATE), divergences=0,
                           mode='free_run')


def coloured(rng, samples, seconds):
    """Make noise of variance 1 with a memory: an AR(1) with this time constant."""
    pole = math.exp(-1 / (RATE * seconds)) if seconds else 0.0
    white = rng.standard_normal(samples + 1000)
    return lfilter([math.sqrt(1 - pole * pole)], [1.0, -pole], white)[1000:]


def looked_at(duel, a, b):
    """Feed residuals, look after each block, and say when it was called better [s] or None."""
    for k, (one, other) in enumerate(zip((a * a).tolist(), (b * b).tolist(), strict=True)):
        duel.take(one, other)
        if k % 50 == 0 and duel.outcome == 'better':
            return duel.seconds
    return None


def test_the_capital_is_the_average_of_the_products():
    rng = np.random.default_rng(0)
    gains = rng.uniform(-1, 1, 40)
    bet = Bet(0.05)
    for gain in gains:
        bet.take(float(gain))
    expected = np.mean([np.prod(1 + share * (gains - 0.05) / 1.05) for share in SHARES])
    assert bet.e_value == pytest.approx(expected, rel=1e-9)
    with pytest.raises(ValueError, match='from -1 to 1'):
        bet.take(1.5)


def test_no_gain_is_expected_where_there_is_none():
    """The mean capital over all ways in which five fair blocks may end is 1: exactly."""
    values = []
    for code in range(32):
        bet = Bet()
        for k in range(5):
            bet.take(1.0 if code >> k & 1 else -1.0)
        values.append(bet.e_value)
    assert np.mean(values) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize('alpha', [0.2, 0.05])
def test_false_alarms_of_the_bare_bet_under_a_skewed_null(alpha):
    """However one looks: 600 runs of 300 blocks, of mean zero but far from symmetric."""
    rng = np.random.default_rng(1)
    false = 0
    for _ in range(600):
        bet = Bet()
        for gain in np.where(rng.random(300) < 0.2, 0.8, -0.2).tolist():
            if bet.take(gain) >= -math.log(alpha):
                false += 1
                break
    assert false / 600 <= alpha + 3 * math.sqrt(alpha * (1 - alpha) / 600)


@pytest.mark.slow
@pytest.mark.parametrize('seconds', [0.0, 0.02, 0.2])
def test_equal_models_are_rarely_promoted_coloured_too(seconds):
    """Residuals of two equal models that share half of their variance, looked at all the time."""
    rng = np.random.default_rng(2)
    runs, alpha, samples = 200, 0.05, 60_000
    false = 0
    for _ in range(runs):
        common, ours, theirs = (coloured(rng, samples, seconds) for _ in range(3))
        duel = Duel(twin(), twin(), Rules(alpha, gain=0.0, least=0.0))
        # In lots, as the sums of a block are all that the bet sees.
        false += _lots(duel, (common + ours) ** 2, (common + theirs) ** 2)
    print(f'memory {seconds} s: {false} of {runs}')
    assert false <= runs * alpha + 3 * math.sqrt(runs * alpha * (1 - alpha))


def _lots(duel, a, b):
    """Feed squares block by block; whether it was ever called better."""
    learn = duel._learn
    for one, other in zip(a[:learn].tolist(), b[:learn].tolist(), strict=True):
        duel.take(one, other)
    size, count = duel.block, (len(a) - learn) // duel.block
    sums = [x[learn:learn + size * count].reshape(count, size).sum(axis=1) for x in (a, b)]
    for pair in zip(*(x.tolist() for x in sums), strict=True):
        duel._sums, duel._count = list(pair), size
        duel._close()
        if duel.better.log_capital >= -math.log(duel.rules.alpha):
            return True
    return False


def test_a_better_model_is_found_soon_and_a_worse_one_too():
    rng = np.random.default_rng(3)
    noise = coloured(rng, 60_000, 0.02)
    lack = 1.5 * coloured(rng, 60_000, 0.05)
    duel = Duel(twin(), twin(), Rules(0.001, 0.02, least=20.0))
    found = looked_at(duel, noise + lack, noise)
    assert found is not None
    assert found < 60.0
    evidence = duel.evidence()
    assert evidence['e_value'] >= evidence['needed'] == pytest.approx(1000.0)
    assert evidence['rms_challenger'] < evidence['rms_champion']
    worse = Duel(twin(), twin(), Rules(0.001, 0.02, least=20.0))
    assert looked_at(worse, noise, noise + lack) is None
    assert worse.outcome == 'worse'


def test_a_gain_below_the_least_is_not_enough():
    rng = np.random.default_rng(4)
    noise = coloured(rng, 100_000, 0.0)
    assert looked_at(Duel(twin(), twin(), Rules(0.01, 0.05, 0.0)), noise, 0.99 * noise) is None
    assert looked_at(Duel(twin(), twin(), Rules(0.01, 0.0, 0.0)), noise, 0.99 * noise)
    assert least_gain(0.05) == pytest.approx((1 - 0.95) / (1 + 0.95))


def test_autocorrelation_time_is_that_of_the_process():
    """For an AR(1) whose pole is p it is (1 + p) / (1 - p), the sum of its autocorrelation."""
    rng = np.random.default_rng(5)
    for pole in (0.0, 0.9, 0.98):
        found = np.mean([autocorrelation_time(lfilter(
            [1.0], [1.0, -pole], rng.standard_normal(20_000))) for _ in range(20)])
        assert found == pytest.approx(max((1 + pole) / (1 - pole), 1.0), rel=0.35)


def test_a_block_in_which_one_diverges_is_lost_by_it():
    duel = Duel(twin(), twin(), Rules())
    for _ in range(duel._learn):
        duel.take(1.0, 1.0)
    for _ in range(40):
        duel.challenger.divergences += 1
        duel._close()
    assert duel.worse.e_value > 1000.0
    assert duel.outcome == 'worse'
    assert [relative_gain(*pair) for pair in ((0.0, 0.0), (math.inf, 1.0), (1.0, math.inf),
                                              (3.0, 1.0))] == [0.0, 1.0, -1.0, 0.5]
