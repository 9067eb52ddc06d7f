"""The inputs of the live twin, without ROS: serialised messages in, samples for the twins out."""
from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hydro_twin.live.aligner import Aligner
from hydro_twin.live.reader import Reader
from hydro_twin.live.sensor import Sensor
from hydro_twin.live.track import OUTPUT, SENSOR, Track
from hydro_twin.plants import Plant
from hydro_twin.recording.cdr import CdrError
from hydro_twin.recording.signals import SignalMap


@dataclass(eq=False)
class Feed:
    """One topic: how to read it, the signals on it, and what was wrong with its messages."""

    topic: str
    type: str
    reader: Reader
    tracks: tuple[Track, ...]
    messages: int = 0
    malformed: int = 0
    fault: str = ''
    arrived: int = 0   # when `TwinInputs.tick` saw the newest message [ns]
    ticked: int = 0    # messages that it had seen

    @property
    def optional(self) -> bool:
        """Whether there are only sensors on it, without which all goes on."""
        return all(track.index == SENSOR for track in self.tracks)


class TwinInputs:
    """The inputs of the twins of one plant.

    Attributes:
        feeds: the topics to listen to.
        aligner: makes samples of what they bring.
        begun: whether `begin` was called.
    """

    def __init__(self, plant: Plant, signals: Mapping[str, SignalMap], sample_time: float,
                 wait: float) -> None:
        """Listen to the signals of a plant, and to those sensors that are among `signals`.

        Times in s.
        """
        step = sample_time * 1e9
        tracks = {signal.name: Track(signal.name, index, signal.held, step)
                  for index, signal in enumerate(plant.inputs)}
        tracks[plant.output.name] = Track(plant.output.name, OUTPUT, plant.output.held, step)
        sensors = {sensor.name: Sensor(sensor.name, SENSOR, False, step)
                   for sensor in plant.sensors if sensor.name in signals}
        self.aligner = Aligner(tuple(tracks.values()), sample_time, wait,
                               [sensors.get(sensor.name) for sensor in plant.sensors])
        tracks |= sensors
        topics: dict[str, list[str]] = {}
        for name in tracks:
            topics.setdefault(signals[name].topic, []).append(name)
        self.begun = False
        self.feeds = tuple(
            Feed(topic, signals[names[0]].type,
                 Reader([signals[name] for name in names],
                        [signals[name] for name in names if name in sensors]),
                 tuple(tracks[name] for name in names))
            for topic, names in topics.items())

    def begin(self, publishers: Mapping[str, int]) -> None:
        """Wait for no sensor that nobody publishes; before the first message is taken in.

        Args:
            publishers: topic -> how many nodes publish on it.
        """
        self.begun = True
        for feed in self.feeds:
            if feed.optional:
                for track in feed.tracks:
                    track.awaited = publishers.get(feed.topic, 0) > 0
        self.aligner.attend()

    def take(self, feed: Feed, payload: bytes, now: Callable[[], int]) -> None:
        """Take in one message; its time is its stamp or, if it has none, that of its arrival.

        Args:
            feed: the topic that it came on.
            payload: CDR.
            now: tells the time, asked only for messages without a stamp [ns].
        """
        feed.messages += 1
        try:
            stamp, values = feed.reader.read(payload)
        except CdrError as error:
            feed.malformed += 1
            feed.fault = str(error.args[0])
            return
        stamp = stamp or now()
        push = self.aligner.push
        for track, value in zip(feed.tracks, values, strict=True):
            if value is not None:   # else this message is about other joints
                push(track, stamp, value)
            elif track.index == SENSOR and not track.samples:
                track.awaited = False   # these messages have no such field

    def tick(self, now: int) -> None:
        """Note for how long nothing has come, so that `aligner` fills in what is late.

        Args:
            now: by a clock that runs with the stamps: slower where a bag is played slower [ns].
        """
        for feed in self.feeds:
            if feed.messages != feed.ticked:
                feed.ticked = feed.messages
                feed.arrived = now
        newest = max(feed.arrived for feed in self.feeds if not feed.optional)
        self.aligner.note_silence(max(now - newest, 0))
