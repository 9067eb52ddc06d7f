import gc
import weakref

from bags_by_hand import rig, write_bag
import numpy as np

from hydro_twin.recording import read
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
