"""What the node says of itself once a second, from the counters of the live twin."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
import math

from hydro_twin.live.inputs import Feed, TwinInputs
from hydro_twin.live.track import SENSOR
from hydro_twin.live.twin import MAIN, Twin

TIME = 'time'   # the part that says whether time runs on
GAPS = 3.0      # periods of a topic without a message, from which on it counts as silent
DUE = 2.0       # predictions that are due and do not come, from which on that is said


class Level(IntEnum):
    """The levels of diagnostic_msgs/msg/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Status:
    """One entry of /diagnostics."""

    part: str
    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


def _input_part(feed: Feed) -> str:
    return f'input {feed.topic}'


def _model_part(twin: Twin) -> str:
    return f'model {twin.name or MAIN}'


class Diagnosis:
    """Turns counters into statuses; it remembers those of the last time."""

    def __init__(self, inputs: TwinInputs, twins: Sequence[Twin]) -> None:
        """Diagnose the inputs and these twins."""
        self.inputs = inputs
        self.twins = twins
        self._last: dict[tuple[object, str], int] = {}
        self._silent: dict[Twin, float] = {}    # for how long each has made no prediction [s]

    def replace(self, twins: Sequence[Twin]) -> None:
        """Diagnose these twins instead of those of the same names, and the others as before."""
        running = {twin.name: twin for twin in [*self.twins, *twins]}
        self.twins = list(running.values())
        gone = [owner for owner, _ in self._last
                if isinstance(owner, Twin) and owner not in self.twins]
        self._last = {key: value for key, value in self._last.items() if key[0] not in gone}
        self._silent = {twin: time for twin, time in self._silent.items() if twin in self.twins}

    def statuses(self, now: int, elapsed: float, publishers: Mapping[str, int]) -> list[Status]:
        """Say how things stand.

        Args:
            now: by the clock of the arrivals [ns].
            elapsed: since the last call [s].
            publishers: topic -> how many nodes publish on it.
        """
        statuses = [self._feed(feed, now, elapsed, publishers.get(feed.topic, 0))
                    for feed in self.inputs.feeds]
        statuses.append(self._time())
        statuses += [self._twin(twin, elapsed) for twin in self.twins]
        return statuses

    def inactive(self) -> list[Status]:
        """Say of the same parts that nothing is asked of them now."""
        parts = [*map(_input_part, self.inputs.feeds), TIME, *map(_model_part, self.twins)]
        return [Status(part, Level.OK, 'inactive') for part in parts]

    def _new(self, owner: object, counter: str) -> int:
        """Return by how much a counter has grown since the last time."""
        value = getattr(owner, counter)
        grown: int = value - self._last.get((owner, counter), 0)
        self._last[owner, counter] = value
        return grown

    def _feed(self, feed: Feed, now: int, elapsed: float, publishers: int) -> Status:
        """Say how the messages of one topic come in."""
        arrived = self._new(feed, 'messages')
        malformed = self._new(feed, 'malformed')
        faults = [f'{malformed} malformed: {feed.fault}'] if malformed else []
        for counter, what in (('not_finite', 'not finite'), ('reordered', 'out of order'),
                              ('duplicates', 'with a repeated stamp'), ('late', 'too late')):
            faults += [f'{track.name}: {count} {what}' for track in feed.tracks
                       if (count := self._new(track, counter))]
        names = [track.name for track in feed.tracks
                 if feed.messages and not track.samples and track.index != SENSOR]
        faults += [f'no message holds {name}' for name in names]
        if publishers > 1:
            faults.append(f'{publishers} publishers on one topic')
        needed = any(track.needed for track in feed.tracks)
        age = (now - feed.arrived) * 1e-9
        # What comes once a second may come twice in one second and not in the next.
        patience = GAPS * 1e-9 * max(track.period for track in feed.tracks)
        silent = not arrived and not (feed.messages and 0.0 <= age <= patience)
        if feed.optional and not feed.messages and not publishers:
            level = Level.OK
            faults = ['no such sensor']
        elif silent:
            level = Level.STALE if needed else Level.WARN
            faults.insert(0, 'no message yet' if not feed.messages else
                          f'no message for {age:.1f} s')
        elif names or 0 < arrived <= malformed:
            level = Level.ERROR
        else:
            level = Level.WARN if faults else Level.OK
        values = {'rate [Hz]': f'{arrived / elapsed:.1f}', 'messages': f'{feed.messages}',
                  'publishers': f'{publishers}', 'malformed': f'{feed.malformed}'}
        if feed.messages:
            values['age [s]'] = f'{age:.3f}'
        for track in feed.tracks:
            for counter in ('duplicates', 'reordered', 'not_finite', 'late', 'filled'):
                values[f'{track.name} {counter}'] = f'{getattr(track, counter)}'
        return Status(_input_part(feed), level, '; '.join(faults) or 'receiving', values)

    def _time(self) -> Status:
        """Say whether time runs on."""
        aligner = self.inputs.aligner
        jumped = self._new(aligner, 'jumps')
        begun = self._new(aligner, 'series')
        values = {'series begun': f'{aligner.series}', 'jumps back': f'{aligner.jumps}'}
        if jumped:
            return Status(TIME, Level.WARN, f'reset: {aligner.reason}', values)
        if begun and aligner.series > 1:
            return Status(TIME, Level.WARN, 'reset after a gap in the inputs', values)
        return Status(TIME, Level.OK, 'running', values)

    def _twin(self, twin: Twin, elapsed: float) -> Status:
        """Say how one twin does."""
        made = self._new(twin, 'predictions')
        diverged = self._new(twin, 'divergences')
        monitor = twin.monitor
        wanted = 1.0 / twin.predictor.sample_time
        silent = self._silent[twin] = 0.0 if made else self._silent.get(twin, 0.0) + elapsed
        values = {'file': f'{twin.about.get("path", "")}', 'mode': twin.mode,
                  'rate [Hz]': f'{made / elapsed:.1f}',
                  'rate wanted [Hz]': f'{wanted:.1f}', 'predictions': f'{twin.predictions}',
                  'divergences': f'{twin.divergences}'}
        level, message = Level.OK, 'model holds'
        if monitor is None:
            message = 'not monitored: the model file states no held-out error'
        else:
            values['residual reference'] = f'{monitor.reference_rms:.6g}'
            if not math.isnan(monitor.rms):
                values['residual'] = f'{monitor.rms:.6g}'
            if monitor.chart is not None:
                values['delay of alarm [s]'] = f'{monitor.chart.delay:.1f}'
            if monitor.colour is not None and not math.isnan(monitor.colour.share):
                values['predictable share of the residual'] = f'{monitor.colour.share:.3f}'
            if monitor.rise is not None:
                rise = monitor.rise
                level = Level.WARN
                what = (f'the RMS of the residual is {rise.rms / rise.reference_rms:.2f} times '
                        'the reference' if rise.sign == 'level' else
                        'the innovation is less white than it was')
                if rise.location is not None:
                    where = rise.location
                    what += f'; the fault {where}'
                    values['location'] = ' or '.join(where.ports)
                    values['location likelier by [nat]'] = f'{where.gain:.0f}'
                    values['location less likely by [nat]'] = ', '.join(
                        f'{port} {less:.0f}' for port, less in where.others)
                message = (f'refit: {what}; record data like that from stamp '
                           f'{rise.begin * 1e-9:.3f} to {rise.end * 1e-9:.3f}')
        sensors = twin.sensors
        if sensors:
            values['sensors'] = ', '.join(sensors)
        if doubted := [name for name, believed in sensors.items() if not believed]:
            values['sensors left out'] = ', '.join(doubted)
            if level is Level.OK:
                level = Level.WARN
                message = f'{", ".join(doubted)} contradicts the other measurements: left out'
        if diverged:
            level, message = Level.ERROR, f'diverged {diverged} times and was reset'
        elif not made and (not twin.predictions or silent * wanted >= DUE):
            level, message = Level.WARN, 'no predictions: waiting for inputs'
        # One more or less is due in a second, by when it begins.
        elif made and made + 1 < 0.9 * wanted * elapsed and level is Level.OK:
            level, message = Level.WARN, f'{made / elapsed:.1f} of {wanted:g} predictions a second'
        return Status(_model_part(twin), level, message, values)
