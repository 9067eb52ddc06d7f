"""Samples of the signals in, samples of the grid out: `recording.grid`, one at a time.

A grid time is due as soon as every signal has reached it. A signal that stays behind the others
for longer than a bounded wait is filled in by its last value, and that is counted. Sensors beside
the output are read where they are there; one that falls silent is not waited for again.
"""
from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np

from hydro_twin.live.sensor import Sensor
from hydro_twin.live.track import JUMP, Track
from hydro_twin.recording.grid import MAX_GAP, ROUNDING


class Aligner:
    """Puts signals on one grid.

    After each `push` or `note_silence`, call `advance` until it is False; while it is True,
    `stamp`, `inputs` and `measured` are the next sample, and `first` says that it begins a new
    series.

    Attributes:
        stamp: of the sample [ns].
        inputs: shape (m,), overwritten by the next sample.
        measured: the output, nan where it is not known.
        sensors: what is measured beside it, nan likewise, (R,), overwritten likewise.
        series: how many have begun.
        jumps: how often a clock jumped back, so that everything had to be forgotten.
        reason: what was said of the last of them.
    """

    def __init__(self, tracks: Sequence[Track], sample_time: float, wait: float,
                 sensors: Sequence[Sensor | None] = ()) -> None:
        """Align signals on a grid; times in s; `sensors` as the plant has them, None of no use."""
        self.tracks = tracks
        self.sensors = np.full(len(sensors), np.nan)
        self._declared = [(k, sensor) for k, sensor in enumerate(sensors) if sensor is not None]
        self.attend()
        self.inputs = np.zeros(sum(track.needed for track in tracks))
        self.measured = math.nan
        self.stamp = -1
        self.first = True
        self.series = 0
        self.jumps = 0
        self.reason = ''
        self._step = sample_time * 1e9
        self._rounding = round(ROUNDING * self._step)
        self.bound_wait(wait)
        self._due: int | None = None   # the next grid time, None between two series
        self._start = 0                # of this series
        self._count = 0                # samples of it
        self._floor = 0                # no series begins before
        self._horizon = -1             # newest stamp of any signal
        self._silence = 0              # time since it came
        self._leap: tuple[int, int] | None = None   # stamps before and after a pause of all

    def attend(self) -> None:
        """Read from now on the sensors that have sent something, or are awaited.

        The others are nan. To ask each of them at every sample would delay the predictions.
        """
        self._sensors = [(k, sensor) for k, sensor in self._declared
                         if sensor.awaited or sensor.samples]

    def push(self, track: Track, stamp: int, value: float) -> None:
        """Take in a sample of a signal; stamp in ns."""
        if isinstance(track, Sensor):
            if track.newest - stamp > JUMP:
                track.clear()           # the others tell whether it is time that has jumped
            first = track.samples == 0
            if track.take(stamp, value):
                track.late += track.counts_until(stamp) <= self.stamp
            if first:
                self.attend()
            return
        if track.newest - stamp > JUMP:
            self.restart(stamp)
            self.jumps += 1
            self.reason = f'stamps of {track.name} jumped back'
        leap = max(JUMP, MAX_GAP * track.period)
        if not track.take(stamp, value):
            return
        track.late += stamp <= self.stamp
        if stamp > self._horizon:
            if 0 <= self._horizon < stamp - self._silence - leap:
                # Too much to fill in, however well commands hold; but signals that lag may
                # still bring what was before.
                if self._leap:
                    self._end(stamp)
                self._leap = self._horizon, stamp
            self._horizon = stamp
            self._silence = 0

    def bound_wait(self, wait: float) -> None:
        """Wait no longer than this for a late signal [s]."""
        self._wait = wait * 1e9

    def note_silence(self, silence: int) -> None:
        """Note how long nothing has come [ns], so that `advance` continues while inputs rest.

        If an input is sent at a rate, silence is a stall and is ignored: later stamps decide.
        """
        resting = all(track.resting for track in self.tracks if track.needed)
        self._silence = silence if resting else 0

    def restart(self, stamp: int = 0) -> None:
        """Forget everything; the next sample begins a new series.

        Args:
            stamp: to which time has jumped back [ns]: what sensors have sent since is kept.
        """
        for track in self.tracks:
            track.clear()
        for _, sensor in self._sensors:
            if not stamp or sensor.newest - stamp > JUMP:
                sensor.clear()
        self._horizon, self._silence, self.stamp, self._leap = -1, 0, -1, None
        self._end(0)

    def advance(self) -> bool:
        """Make the next sample, if all it needs is there or has been waited for long enough."""
        while True:
            due = self._begin() if self._due is None else self._due
            if due is None:
                return False
            reached = self._reach(due)
            if reached is None:
                self._end(self.stamp + 1)
                if self._leap and due > self._leap[0]:
                    self._end(self._leap[1])
                    self._leap = None
                continue
            if reached:
                self._fill(due)
                self.stamp = due
                self.first = not self._count
                self.series += self.first
                self._count += 1
                self._due = self._start + round(self._count * self._step)
            return reached

    def _end(self, floor: int) -> None:
        """End the series; the next one begins no earlier than `floor` [ns]."""
        self._due = None
        self._floor = floor

    def _begin(self) -> int | None:
        """Begin a series at the first stamp at which all signals are known, if it has come."""
        start = self._floor
        for track in self.tracks:
            first = track.first()
            if first is not None:
                start = max(start, first)
            elif track.needed:
                return None
        for track in self.tracks:
            if track.first() is None and track.awaited:
                if self._patient(track, start):
                    return None
                track.awaited = False
        self._due = self._start = start
        self._count = 0
        return start

    def _patient(self, track: Track, due: int) -> bool:
        """Say whether a signal that has not reached a grid time is worth waiting for."""
        wait = self._wait if track.held else self._wait + track.period
        return due > self._now(due) - wait

    def _now(self, due: int) -> int:
        """Say how far the stamps have come, not counting a pause after this grid time."""
        pause = self._leap[1] - self._leap[0] if self._leap and due <= self._leap[0] else 0
        return self._horizon + self._silence - pause

    def _reach(self, due: int) -> bool | None:
        """Step all signals up to a grid time.

        Returns:
            True if they are there or given up, False to wait, None if a gap ends the series.
        """
        if due > self._horizon + max(self._silence - self._wait, 0):
            return False   # nobody is there yet
        if self._leap and self._leap[0] < due < self._leap[1]:
            return None
        now = self._now(due)
        ready = True
        for track in self.tracks:
            after = track.after
            while after and after[0][0] <= due:
                if track.breaks(after[0][0]):
                    return None
                track.before = after.popleft()
            before = track.before
            if before is not None and before[0] >= due:
                continue
            if after:
                if before is None or track.breaks(due):
                    return None
            elif track.awaited and not track.rests and self._patient(track, due):
                ready = False
            elif track.needed and track.breaks(due if track.held else max(due, now)):
                return None
        return ready and self._reach_sensors(due)

    def _reach_sensors(self, due: int) -> bool:
        """Step the sensors up to a grid time; False to wait for one of them."""
        for _, sensor in self._sensors:
            if not sensor.reach(due):
                if due > self._now(due) - self._wait:
                    return False
                sensor.awaited = False
                sensor.filled += 1
        return True

    def _fill(self, due: int) -> None:
        """Take the values of all signals at a grid time."""
        self.measured = math.nan
        for k, sensor in self._sensors:
            self.sensors[k] = sensor.read(due)
        for track in self.tracks:
            # Not before all are there: where a gap of another prevents this sample, the next
            # series would begin later.
            if track.held and track.after and track.after[0][0] <= due + self._rounding:
                track.before = track.after.popleft()
            if track.before is None:
                continue   # the output before it has come for the first time
            stamp, value = track.before
            if stamp < due:
                if not track.after:
                    track.awaited = False
                    track.filled += 1
                    if not track.needed:
                        continue
                elif not track.held:
                    end, later = track.after[0]
                    value += (due - stamp) / (end - stamp) * (later - value)
            if track.needed:
                self.inputs[track.index] = value
            else:
                self.measured = value
