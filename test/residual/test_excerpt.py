"""Long recordings are cut to stretches, spread evenly, whatever the output."""
import numpy as np
import pytest

from hydro_twin.fitting.candidate import Part, START
from hydro_twin.residual.excerpt import ENOUGH, excerpt


def part(n, source):
    return Part(np.arange(n, dtype=float)[:, None], np.arange(n, dtype=float), source)


def test_what_is_short_is_kept_whole():
    parts = [part(1000, 'a'), part(3000, 'b')]
    assert excerpt(parts) == parts


@pytest.mark.parametrize('lengths', [(1_800_000,), (100_000, 100_000), (7_000, 3_000, 500),
                                     (600,) * 400])
def test_enough_is_kept_from_begin_to_end(lengths):
    parts = [part(n, str(k)) for k, n in enumerate(lengths)]
    cut = excerpt(parts)
    scored = sum(len(p.measured) - START for p in cut)
    assert 0.4 * ENOUGH <= scored <= 3 * ENOUGH
    for one in cut:
        np.testing.assert_array_equal(one.inputs[:, 0], one.measured)   # cut alike
        assert (np.diff(one.measured) == 1).all()
    firsts = [(int(one.source), one.measured[0]) for one in cut]
    assert firsts == sorted(firsts)
    assert int(cut[-1].source) >= 0.9 * (len(lengths) - 1)
    if len(lengths) == 1:
        starts = [first for _, first in firsts]
        assert starts[0] < 0.1 * lengths[0]
        assert starts[-1] > 0.8 * lengths[0]
