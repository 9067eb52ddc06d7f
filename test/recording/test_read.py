import gc
import weakref

from bags_by_hand import joint_state, rig, write_bag
import numpy as np
import pytest

from hydro_twin.plants import PLANTS
from hydro_twin.recording import read
from hydro_twin.recording import rig as rigs
from hydro_twin.recording.signals import SignalMap

SIGNALS = {
    'u': SignalMap('/command', 'sensor_msgs/msg/JointState', 'position[0]'),
    'T': SignalMap('/states', 'sensor_msgs/msg/JointState', 'effort[0]'),
}


def test_one_bag_is_held_at_a_time(tmp_path, monkeypatch):
    bags = [write_bag(tmp_path / str(k), rig(40, start=10**18 + k * 10**12, seed=k))
            for k in range(3)]
    held, still_there = [], []
    read_signals = read.read_signals    # type: ignore[attr-defined]

    def watched(*arguments):
        gc.collect()
        still_there.append(sum(ref() is not None for ref in held))
        found = read_signals(*arguments)
        held.extend(weakref.ref(samples) for samples in found.values())
        return found

    monkeypatch.setattr(read, 'read_signals', watched)
    recording = read.read_recording(bags, SIGNALS, ['u'], 0.002)
    assert len(held) >= 6
    assert not any(still_there)
    for series, bag in zip(recording.series, bags, strict=True):
        np.testing.assert_array_equal(series['T'], read_signals(bag, SIGNALS)['T'].values)


@pytest.mark.parametrize(('periods', 'readings'), [
    ([10, 10, 10], [0, 1, 2]), ([40, 10, 20], [0, 1, 2]), ([10, 40, 20], [0, 1, 2, 0])])
def test_a_bag_is_read_again_only_where_a_slower_one_came_after_it(
        tmp_path, monkeypatch, periods, readings):
    """The result is that of reading all at the sample time of the slowest."""
    plant = PLANTS['cylinder']
    cylinder = rigs.rig_of(plant)
    bags = []
    for k, period in enumerate(periods):
        stamps = 10**18 + k * 10**12 + period * 1_000_000 * np.arange(4000 // period)
        bags.append(write_bag(tmp_path / str(k), [
            (cylinder.signals[name].topic, int(t),
             joint_state(int(t), position=[np.sin(1e-9 * (t % 10**12) + phase)]))
            for t in stamps for name, phase in (('command', 0.0), ('x', 1.0))]))
    read_signals, seen = rigs.read_signals, []      # type: ignore[attr-defined]
    monkeypatch.setattr(rigs, 'read_signals', lambda bag, *signals: (
        seen.append(bags.index(bag)), read_signals(bag, *signals))[1])
    found = rigs.read_apart([bags[:2], bags[2:]], cylinder)
    assert seen == readings
    for group, recording in zip((bags[:2], bags[2:]), found, strict=True):
        expected = read.read_recording(group, cylinder.signals, {'command'}, 1e-3 * max(periods))
        assert recording.sources == expected.sources
        for one, other in zip(recording.series, expected.series, strict=True):
            assert (one.start, one.sample_time, one.source) == (
                other.start, other.sample_time, other.source)
            for name in ('command', 'x'):
                np.testing.assert_array_equal(one[name], other[name])
