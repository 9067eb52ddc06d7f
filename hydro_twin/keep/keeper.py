"""The loop of `keep`, without ROS: an event of the twin in, a better model in the store out.

    event -> capturing -> tracing -> judging -> promoted -> on probation -> confirmed
                 ^         |    |       |                        |
                 `-- not enough |   discarded               rolled back
                              failed

A capture does not interrupt anything else. All methods belong to one thread; long work is a job.
"""
from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from hydro_twin.errors import UserError
from hydro_twin.keep.capture import Capture, Captured, close, prune, untraced, write
from hydro_twin.keep.follow import BY, Follower
from hydro_twin.keep.jobs import Jobs
from hydro_twin.keep.ring import Ring, SECOND
from hydro_twin.keep.settings import OBSERVE
from hydro_twin.keep.tracing import Bounds, MIB, NotEnoughError, trace
from hydro_twin.keep.trial import Judge
from hydro_twin.live.diagnostics import Level, Status
from hydro_twin.live.messages import typestore
from hydro_twin.recording.signals import SignalMap
from hydro_twin.store.lineage import recordings, sources
from hydro_twin.store.store import Store
from hydro_twin.store.version import CAPTURES, DISCARDED, PROMOTED, Version


class Keeper:
    """Keeps the champion of a store up to date with the rig, and has the twin run it.

    Attributes:
        ring, capture: of the inputs of the twin.
        judge: of models.
        signals: where the inputs are found, once that is known.
        topics: what is captured: name -> type, and whether it is latched.
        twin: what it runs.
        waiting: captures that are to be traced.
        times: at which steady time which stamp was the newest [ns].
        fault: what went wrong last, on one line; '' after a success.
        troubles: what goes wrong now, a line each.
        uncaptured: topics that are to be captured and cannot be: name -> why.
        lacking: what the last stretch said too little of, while a better one is waited for.
        champion, challenger: as the store had them last.
    """

    def __init__(self, store: Store, get: Callable[[str], Any],
                 announce: Callable[..., object], set_model: Callable[[Path], object]) -> None:
        """Take up where the store was left.

        Args:
            store: of the versions.
            get: the value of a parameter.
            announce: called with the name of an event and what is to be said of it.
            set_model: has the twin run a model file; `answered` is called with the outcome.
        """
        self.store, self.get, self.announce = store, get, announce
        self.jobs = Jobs()
        self.ring = Ring(get('before'), round(get('ring') * MIB))
        self.capture = Capture(self.ring)
        self.judge = Judge(store, get, self.jobs, announce)
        self.signals: dict[str, SignalMap] = {}
        self.topics: dict[str, tuple[str, bool]] = {}
        self.uncaptured: dict[str, str] = {}
        self.twin = Follower(store, get, set_model)
        self.captures = store.path / CAPTURES
        self.waiting: deque[Captured] = deque(untraced(self.captures))
        self.times: deque[tuple[int, int]] = deque()    # steady time, stamp
        self.fault = ''
        self.troubles: list[str] = []
        self.champion: Version | None = None
        self.challenger: Version | None = None
        self.lacking = ''
        self._settled: int | None = None   # when the residual had risen, on the steady clock [ns]
        self._due: int | None = None       # when a capture is made without an event
        # Since when the model does not hold, or the last try, on the steady clock [ns].
        self._failing_since: int | None = None

    # What comes in

    def note_time(self, now: int, stamp: int) -> None:
        """Note at which steady time a stamp was the newest [ns], now and then."""
        self.times.append((now, stamp))
        while self.times[0][0] < now - round(self.ring.seconds * SECOND):
            self.times.popleft()

    def refit(self, now: int, event: Mapping[str, Any]) -> None:
        """Capture on the twin's event that its model no longer holds; steady time in ns."""
        if event.get('model'):
            return     # of one that runs beside the champion
        settled, since = event.get('settled'), None
        where = event.get('location')
        if isinstance(settled, int):     # what was before would blur what it has become
            since = next((then for then, stamp in self.times if stamp >= settled), now)
        self._failing_since, self._settled, self.lacking = now, since, ''
        self.ask(now, f'refit: the residual is {event.get("rms", 0.0):.4g}, reference '
                      f'{event.get("reference_rms", 0.0):.4g}'
                      + (f'; the fault {where["says"]}' if where else ''), since)

    def ask(self, now: int, why: str, since: int | None = None) -> None:
        """Capture."""
        self.capture.ask(now, self.get('after'), why, since)

    def informed(self, twins: Sequence[Mapping[str, Any]]) -> None:
        """Hear what the twin runs."""
        if self.twin.informed(twins):
            self._failing_since, self.lacking = None, ''

    def answered(self, refusal: str) -> None:
        """Hear why the twin refuses the champion, if it does."""
        champion = self.champion
        if not refusal or champion is None or not self.twin.refused(champion):
            return
        self._fail(f'the twin refuses version {champion.name}: {refusal}')
        if (champion.decisions[-1]['what'] == PROMOTED
                and self.store.predecessor() is not None):
            self.judge.go_back(BY, None, f'the twin refuses it: {refusal}')

    def promote(self, by: str) -> str:
        """Promote the challenger for a person; returns what was done.

        Raises:
            UserError: there is none, or the policy does not allow it.
        """
        self._check_policy()
        challenger = self.store.challenger
        if challenger is None:
            raise UserError('there is no challenger')
        duel = self.judge.duel if self.judge.on_trial else None
        last = challenger.decisions[-1].get('evidence')
        self.judge.promote(challenger, by, duel.evidence() if duel else last)
        return f'version {challenger.name} is the champion'

    def roll_back(self, by: str) -> str:
        """Go back for a person; returns what was done.

        Raises:
            UserError: there is nothing to go back to, or the policy does not allow it.
        """
        self._check_policy()
        return f'version {self.judge.go_back(by).name} is the champion again'

    def _check_policy(self) -> None:
        if self.get('policy') == OBSERVE:
            raise UserError("the policy is observe, which leaves the twin alone: set it to 'ask'")

    # What is done, once a second or so

    def tick(self, now: int) -> None:
        """Do what is due; steady time in ns. What goes wrong is in `troubles`, not raised."""
        troubles: list[str] = []
        for step in (self.jobs.poll, self._refresh_champion, partial(self._capture, now),
                     lambda: self.twin.work(now, self.champion), self._trace,
                     lambda: self.judge.work(self.mode), partial(self._again, now),
                     partial(self._regularly, now)):
            try:
                step()
            except Exception as error:
                said = (f'{error}' if isinstance(error, UserError | OSError) else
                        f'a defect: {type(error).__name__}: {error}')
                troubles.append(' '.join(said.split()))
        for said in troubles:
            if said not in self.troubles:
                self.announce('fault', says=said)
        self.troubles = troubles

    def _refresh_champion(self) -> None:
        """Take note of the champion; an empty store begins with what the twin runs."""
        self.ring.seconds, self.ring.most = self.get('before'), round(self.get('ring') * MIB)
        champion = self.store.champion or self.twin.first()
        if champion is not None and self.judge.set_champion(champion):
            self.twin.want(champion)
        self.champion, self.challenger = champion, self.store.challenger

    def _capture(self, now: int) -> None:
        if self.jobs.busy('write') or (taken := self.capture.take(now)) is None:
            return
        wanted, messages = taken
        topics = {topic: (kind, topic in self.ring.latched())
                  for topic, (kind, _) in self.topics.items()}

        def done(captured: Captured) -> None:
            self.waiting.append(captured)
            self.announce('captured', bag=str(captured.bag), why=list(wanted.why))
            champion = self.store.champion
            line = sources(self.store, champion) if champion else iter(())
            prune(self.captures, round(self.get('captures')),
                  {Path(source.path) for source in islice(line, self.get('recordings'))})

        self.jobs.start('write', partial(write, self.captures, wanted, messages, topics,
                                         typestore()), done,
                        lambda error: self._fail(f'not captured: {error}'))

    def _trace(self) -> None:
        champion, mode = self.champion, self.mode
        if (not self.waiting or not self.signals or champion is None or mode is None
                or self.judge.on_trial or self.jobs.busy('trace')):
            return
        captured = self.waiting.popleft()
        bounds = Bounds(self.get('trace_time'), self.get('trace_memory'), self.get('nice'))

        def work() -> Path:
            """Find what the champion came from, and trace."""
            return trace(captured, champion.model_file.absolute(),
                         recordings(self.store, champion, self.get('recordings')),
                         dict(self.signals), mode, bounds, self.jobs.stop)

        def failed(error: Exception) -> None:
            if isinstance(error, NotEnoughError):
                close(captured, f'not enough: {error}')
                self.announce('not_enough', bag=str(captured.bag), says=str(error))
                self.lacking = str(error) if self._failing_since is not None else ''
            elif not self.jobs.stop.is_set():     # else it is traced after the next start
                close(captured, f'failed: {error}')
                self.announce('failed', bag=str(captured.bag), why=str(error))
                self._fail(f'trace of {captured.bag}: {error}')

        self.announce('tracing', bag=str(captured.bag), champion=champion.name)
        self.jobs.start('trace', work, partial(self._traced, captured, champion), failed)

    def _traced(self, captured: Captured, champion: Version, folder: Path) -> None:
        """Enter what a trace from a champion on made, and have it judged.

        Where another version has become the champion meanwhile, the capture is traced again.
        """
        now = self.store.champion
        if now is None or now.name != champion.name:
            self.waiting.appendleft(captured)
            return
        old = self.store.challenger
        if old is not None:
            self.store.decide(old.name, DISCARDED, BY, None, 'a newer challenger took its place')
        made = self.store.enter(folder / 'model.yaml', BY, reports=folder, as_challenger=True,
                                bag={'path': str(captured.bag.relative_to(self.store.path)),
                                     'sha256': captured.sha256, 'why': captured.why})
        close(captured, f'version {made.name}')
        self.fault = self.lacking = ''
        self.announce('traced', version=made.name, changed=made.record['changed'])
        self.judge.challenge(champion, made)

    def _again(self, now: int) -> None:
        """Capture again where the model still does not hold, and nothing is being done about it.

        Immediately after a capture with too little excitation, long enough to overlap it.
        """
        pause = self.get('again')
        if self._failing_since is None:
            return
        if self.busy:
            self._failing_since = now
        elif self.lacking:
            self.capture.ask(now, self.get('before'), f'more motion is needed: {self.lacking}',
                             self._settled)
        elif not pause:
            return
        elif now - self._failing_since > pause * SECOND:
            self._failing_since = now
            self.ask(now, 'the model still does not hold')

    def _regularly(self, now: int) -> None:
        """Capture without an event, if that is wanted, where nothing else is being done."""
        every = self.get('every')
        if not every:
            self._due = None
        elif self._due is None:
            self._due = now + round(every * SECOND)
        elif now >= self._due and not self.busy:
            self._due = now + round(every * SECOND)
            self.ask(now, f'every {every:g} s')

    # What is reported

    @property
    def mode(self) -> str | None:
        """The mode in which models are judged; None while it is not known."""
        mode: str = self.get('mode')
        if mode != 'as the twin':
            return mode
        return self.twin.runs['mode'] if self.twin.runs is not None else None

    @property
    def busy(self) -> bool:
        """Whether a stretch is captured, traced or judged."""
        return bool(self.capture.wanted or self.waiting or self.judge.on_trial
                    or any(map(self.jobs.busy, ('write', 'trace'))))

    def status(self, now: int) -> Status:
        """Say what is being done; steady time in ns."""
        doing = [f'capturing, {self.capture.left(now):.0f} s to come'] if self.capture.wanted \
            else []
        doing += ['writing a capture'] if self.jobs.busy('write') else []
        doing += ['tracing'] if self.jobs.busy('trace') else []
        doing += [f'the last stretch was not enough: {self.lacking}'] if self.lacking else []
        doing += [f'{len(self.waiting)} captures to trace'] if self.waiting else []
        doing += [said] if (said := self.judge.says()) else []
        challenger = self.challenger
        if challenger is not None and not self.judge.on_trial:
            doing.append(f'challenger {challenger.name} waits to be promoted: '
                         f'{challenger.record["changed"]}')
        faults = [*filter(None, [self.fault, *self.troubles, self.twin.trouble]),
                  *(f'{topic} is not captured: {why}' for topic, why in self.uncaptured.items())]
        values = {
            'policy': self.get('policy'),
            'champion': self.champion.name if self.champion else '',
            'challenger': challenger.name if challenger else '',
            'ring [s]': f'{self.ring.span():.1f}', 'ring [MiB]': f'{self.ring.size / MIB:.1f}',
            'dropped for want of memory': f'{self.ring.dropped}'}
        return Status('loop', Level.WARN if faults else Level.OK,
                      '; '.join([*(doing or ['idle']), *faults]), values)

    def _fail(self, why: str) -> None:
        """Keep what went wrong, on one line."""
        said = ' '.join(why.split())
        if said != self.fault:
            self.announce('fault', says=said)
        self.fault = said
