"""Reading the columns of a long bag, against rosbags' own deserialising reader in the same run.

    python benchmarks/reading.py [--minutes 10] [--runs 3]

makes a load simulator's bag at 500 Hz in each storage, checks that both ways give the same numbers
to the bit, then times both, turn about, and prints the ratio of the best times.
"""
import argparse
from pathlib import Path
import tempfile
import time
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

from hydro_twin.recording.bag import read_signals
from hydro_twin.recording.series import Series
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording

GOALS = {'mcap': 2.5, 'db3': 4.0}


def deserialised(path, signals):
    """Read the three columns and their stamps as the rosbags manual does."""
    command, state = signals['u_m'].topic, signals['theta_d'].topic
    u_stamps, u_m, stamps, theta_d, T_g = [], [], [], [], []
    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic in (command, state)]
        for connection, _, raw in reader.messages(connections=connections):
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            if connection.topic == command:
                u_stamps.append(stamp)
                u_m.append(message.position[0])
            else:
                stamps.append(stamp)
                theta_d.append(message.position[0])
                T_g.append(message.effort[0])
    return {'u_m': (np.array(u_stamps), np.array(u_m)),
            'theta_d': (np.array(stamps), np.array(theta_d)),
            'T_g': (np.array(stamps), np.array(T_g))}


def columns(path, signals):
    return {name: (samples.stamps, samples.values)
            for name, samples in read_signals(path, signals).items()}


def timed(function, *arguments):
    begin = time.perf_counter()
    result = function(*arguments)
    return time.perf_counter() - begin, result


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--minutes', type=float, default=10.0)
    parser.add_argument('--runs', type=int, default=3)
    args = parser.parse_args()
    signals = load_signals('load_simulator', ['u_m', 'theta_d', 'T_g'])
    count = round(args.minutes * 60 * 500)
    rng = np.random.default_rng(0)
    series = Series({name: rng.standard_normal(count) for name in signals}, 0.002, 10**18)
    missed = False
    with tempfile.TemporaryDirectory() as folder:
        for suffix, goal in GOALS.items():
            path = Path(folder) / f'bag.{suffix}'
            write_recording(path, [series], signals)
            ours, theirs = columns(path, signals), deserialised(path, signals)
            for name in signals:
                for a, b in zip(ours[name], theirs[name], strict=True):
                    assert a.dtype == b.dtype
                    assert a.tobytes() == b.tobytes()
            del ours, theirs
            times = [(timed(columns, path, signals)[0], timed(deserialised, path, signals)[0])
                     for _ in range(args.runs)]
            fast, slow = (min(column) for column in zip(*times, strict=True))
            missed |= slow / fast < goal
            print(f'{suffix}: {2 * count} messages, rosbags {slow:.2f} s, columns {fast:.2f} s: '
                  f'{slow / fast:.1f} times faster (goal {goal}); {args.minutes * 60 / fast:.0f} '
                  'times real time')
    raise SystemExit(missed)


if __name__ == '__main__':
    main()
