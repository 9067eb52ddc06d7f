"""The study's statistics and refusals; the whole study is tested through `compare`."""
from __future__ import annotations

import numpy as np
import pytest

from hydro_twin.errors import DataError
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.recording.series import Recording, Series
from hydro_twin.studies.b19.study import five_numbers, make_part, mann_whitney


def test_five_numbers_are_those_of_the_paper_s_tables() -> None:
    errors = np.array([4.0, 1.0, 3.0, 2.0, 10.0])
    assert five_numbers(errors).tolist() == [1.0, 2.0, 3.0, 4.0, 10.0]
    assert five_numbers(errors[:4])[2] == 2.5


def test_runs_that_diverged_rank_last() -> None:
    errors = np.array([1.0, np.inf, 2.0, np.inf])
    assert five_numbers(errors).tolist() == [1.0, 1.75, np.inf, np.inf, np.inf]
    assert mann_whitney(np.full(20, np.inf), np.arange(20.0)) < 1e-6


def test_mann_whitney_counts_the_pairs() -> None:
    """Exact for 3 against 3: none of 20 orders but two is as extreme as complete separation."""
    assert mann_whitney(np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])) == (
        pytest.approx(2 / 20))
    assert mann_whitney(np.ones(20), np.ones(20)) == 1.0


def recording(samples: int, **columns: np.ndarray) -> Recording:
    rng = np.random.default_rng(0)
    drawn = {name: rng.normal(size=samples) for name in ('u_m', 'theta_d', 'T_g')}
    return Recording((Series({**drawn, **columns}, 0.002),))


@pytest.mark.parametrize('bad', [
    recording(10),
    recording(90),
    recording(300, T_g=np.ones(300)),
    recording(300, u_m=np.r_[np.ones(299), np.nan]),
])
def test_refuses_what_cannot_be_compared(bad: Recording) -> None:
    with pytest.raises(DataError, match='test part: '):
        make_part('test', bad, LOAD_SIMULATOR)


def test_takes_what_can() -> None:
    assert make_part('test', recording(200), LOAD_SIMULATOR).factor.patterns == 195
