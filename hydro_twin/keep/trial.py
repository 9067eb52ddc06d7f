"""Which two versions are judged against each other, and what follows from the evidence."""
from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from hydro_twin.errors import ModelError
from hydro_twin.keep.duel import Duel, in_one_mode, Rules
from hydro_twin.keep.follow import BY
from hydro_twin.keep.jobs import Jobs
from hydro_twin.keep.limits import beyond, parse
from hydro_twin.keep.regime_bets import Regimes
from hydro_twin.keep.regimes import Known, read_known
from hydro_twin.keep.settings import AUTO, OBSERVE
from hydro_twin.live.models import check_same_inputs, Choice, load_twin
from hydro_twin.live.twin import Twin
from hydro_twin.store.store import Store
from hydro_twin.store.version import CONFIRMED, DISCARDED, PROMOTED, RECOMMENDED, Version

TRIAL, PROBATION = 'trial', 'probation'


@dataclass(frozen=True)
class Pair:
    """Two versions: in a trial `other` is the challenger, on probation the predecessor."""

    kind: str
    champion: Version
    other: Version

    @property
    def by_age(self) -> tuple[Version, Version]:
        """The older version, and the newer one that it is about."""
        return ((self.champion, self.other) if self.kind == TRIAL else
                (self.other, self.champion))


class Judge:
    """Loads two versions, runs them side by side, and carries out what the evidence says.

    Attributes:
        pair: what is judged, or about to be.
        duel: of the pair, once its models are loaded.
    """

    def __init__(self, store: Store, get: Callable[[str], Any], jobs: Jobs,
                 announce: Callable[..., object]) -> None:
        """Judge nothing yet.

        Args:
            store: of the versions.
            get: the value of a parameter.
            jobs: to load models in.
            announce: called with the name of an event and what is to be said of it.
        """
        self.store, self.get, self.jobs, self.announce = store, get, jobs, announce
        self.pair: Pair | None = None
        self.duel: Duel | None = None
        self._known: Known | None = None     # of the regimes, for the newer version
        self._champion = ''

    def set_champion(self, champion: Version) -> bool:
        """Take note of the champion; whether it is another one than before.

        A challenger whose trial was not ended is judged (again), else the champion on probation.
        """
        if champion.name == self._champion:
            return False
        self._champion = champion.name
        self.drop()
        challenger = self.store.challenger
        if challenger is not None and challenger.decisions[-1]['what'] not in (
                RECOMMENDED, DISCARDED):
            self.pair = Pair(TRIAL, champion, challenger)
            return True
        predecessor = self.store.predecessor()
        if (self.get('probation') > 0.0 and predecessor is not None
                and champion.decisions[-1]['what'] == PROMOTED):
            self.pair = Pair(PROBATION, champion, predecessor)
        return True

    def challenge(self, champion: Version, challenger: Version) -> None:
        """Judge a new challenger, instead of what is judged now."""
        self.drop()
        self.pair = Pair(TRIAL, champion, challenger)

    def drop(self) -> None:
        """Judge nothing."""
        self.pair = self.duel = self._known = None

    @property
    def on_trial(self) -> bool:
        """Whether a challenger is on trial."""
        return self.pair is not None and self.pair.kind == TRIAL

    def work(self, mode: str | None) -> None:
        """Load what is to be judged in a mode, or judge it; None where no mode is known yet."""
        if self.pair is None:
            return
        if self.duel is None:
            if mode is not None and not self.jobs.busy('load'):
                self._load(self.pair, mode)
            return
        self.duel.rules = self._rules()
        if self.pair.kind == TRIAL:
            self._try(self.pair, self.duel)
        else:
            self._watch(self.pair, self.duel)

    def _rules(self) -> Rules:
        return Rules(self.get('alpha'), self.get('gain'), self.get('trial_least'))

    def _load(self, pair: Pair, mode: str) -> None:
        def load() -> tuple[Twin, Twin, Known | None]:
            """Make both ready to step, and read what is known of the regimes."""
            one, other = (load_twin(Choice(version.name, version.model_file), mode)
                          for version in (pair.champion, pair.other))
            check_same_inputs(other, one)
            one, other = in_one_mode(one, other)
            older, newer = pair.by_age
            known = read_known(newer.folder)
            if known is not None and (known.mode, newer.parent) != (other.mode, older.name):
                known = replace(known, holds={})     # shown in another mode, or against another
            return one, other, known

        def ready(loaded: tuple[Twin, Twin, Known | None]) -> None:
            if self.pair is pair:
                one, other, self._known = loaded
                regimes = None if self._known is None else Regimes(
                    self._known.grid, one.predictor.plant, one.predictor.sample_time,
                    self.get('gain'))
                self.duel = Duel(one, other, self._rules(), regimes,
                                 newer=int(pair.kind == TRIAL))

        def failed(error: Exception) -> None:
            if self.pair is pair:
                self.drop()
                if pair.kind == TRIAL:
                    self._discard(pair, None, f'it cannot be run: {error}')
                else:
                    self.announce('fault', says=f'version {pair.champion.name} is not judged '
                                  f'against its predecessor {pair.other.name}: {error}')
            if not isinstance(error, ModelError):
                raise error

        self.jobs.start('load', load, ready, failed)

    def _try(self, pair: Pair, duel: Duel) -> None:
        outcome, evidence = duel.outcome, duel.evidence()
        pending, over = self.pending(), duel.seconds >= self.get('trial')
        if worse := self._worse(duel):
            self._discard(pair, evidence, f'it is worse than the champion at {worse}')
        elif outcome == 'better' and (over or not pending):
            policy = self.get('policy')
            self.drop()
            why = '; '.join([*beyond(pair.other.model(), parse(self.get('limits'))),
                             *(f'not judged at {name}' for name in pending)])
            if policy == AUTO and not why:
                self.promote(pair.other, f'{BY}, policy {policy}', evidence)
            else:
                self.store.decide(pair.other.name, RECOMMENDED, f'{BY}, policy {policy}', evidence,
                                  why)
                self.announce('recommended', version=pair.other.name, evidence=evidence,
                              changed=pair.other.record['changed'], why=why)
        elif outcome == 'worse':
            self._discard(pair, evidence, 'its residual is larger than that of the champion')
        elif over:
            self._discard(pair, evidence, f'no better within {duel.seconds:.0f} s')

    def pending(self) -> list[str]:
        """Name the regimes seen before in which the newer model is not shown to hold yet."""
        if self.duel is None or self.duel.regimes is None or self._known is None:
            return []
        return self.duel.regimes.pending(self._known, self.get('alpha'))

    def _worse(self, duel: Duel) -> str:
        """Say in which regimes the newer model is worse, and by how much; '' for none."""
        return '' if duel.regimes is None else '; '.join(
            f'{name} ({duel.regimes.compared(name)})'
            for name in duel.regimes.worse(self.get('alpha')))

    def _discard(self, pair: Pair, evidence: Mapping[str, Any] | None, why: str) -> None:
        self.drop()
        self.store.decide(pair.other.name, DISCARDED, BY, evidence, why)
        self.announce('discarded', version=pair.other.name, why=why, evidence=evidence)

    def promote(self, version: Version, by: str, evidence: Mapping[str, Any] | None) -> None:
        """Make a version the champion."""
        self.store.promote(version.name, by, evidence)
        self.announce('promoted', version=version.name, by=by, evidence=evidence,
                      changed=version.record['changed'])

    def _watch(self, pair: Pair, duel: Duel) -> None:
        """Judge a champion on probation: here the challenger is its predecessor."""
        outcome, evidence = duel.outcome, duel.evidence()
        worse = self._worse(duel)
        if worse or outcome == 'better':
            self.drop()
            why = f'it is worse than its predecessor at {worse}' if worse else (
                'its predecessor is better')
            if self.get('policy') == OBSERVE:
                self.announce('worse', version=pair.champion.name, evidence=evidence,
                              than=pair.other.name, why=why)
            else:
                self.go_back(BY, evidence, why)
        elif outcome == 'worse' and not self.pending():
            self.drop()
            self.store.decide(pair.champion.name, CONFIRMED, BY, evidence)
            self.announce('confirmed', version=pair.champion.name, evidence=evidence)
        elif duel.seconds >= self.get('probation'):
            self.drop()

    def go_back(self, by: str, evidence: Mapping[str, Any] | None = None, why: str = '',
                ) -> Version:
        """Make the predecessor the champion again.

        Raises:
            StoreError: there is none.
        """
        version = self.store.roll_back(by, evidence, why)
        self.announce('rolled_back', version=version.name, by=by, why=why, evidence=evidence)
        return version

    def says(self) -> str:
        """Say what is judged, in a few words; '' where nothing is."""
        if self.pair is None:
            return ''
        one, other = self.pair.champion.name, self.pair.other.name
        what = (f'judging challenger {other} against {one}' if self.pair.kind == TRIAL else
                f'judging champion {one} against its predecessor {other}')
        if self.duel is None:
            return f'{what}: loading'
        evidence, left = self.duel.evidence(), self.pending()
        return (f'{what}: {evidence["seconds"]:.0f} s, evidence {evidence["e_value"]:.3g} for and '
                f'{evidence["against"]:.3g} against, of {evidence["needed"]:g}'
                + (f'; still to be seen: {", ".join(left)}' if left else ''))
