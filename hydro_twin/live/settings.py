"""The parameters of the node, its signals aside: name, default, meaning, limits."""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from hydro_twin.errors import UserError

TWIN_MODES = ('one_step', 'free_run', 'observer')    # in which a twin runs


@dataclass(frozen=True)
class Setting:
    """One parameter.

    Attributes:
        default: of a list of texts, a tuple; one empty text stands for none.
        choices: all that a text may be, if that is known here.
        bounds: of a number, both included.
        check: raises a UserError for a value that cannot be.
        read_only: it is read at the start of the node and never again.
    """

    name: str
    default: str | float | int | bool | tuple[str, ...]
    description: str
    choices: tuple[str, ...] = ()
    bounds: tuple[float, float] | None = None
    read_only: bool = False
    check: Callable[[Any], object] | None = None

    def objection(self, value: object) -> str:
        """Say why the parameter cannot have a value of the right type, or ''."""
        if self.choices and value not in self.choices:
            return f'{self.name} {value!r}: there are {" and ".join(self.choices)}'
        if self.check is not None:
            try:
                self.check(value)
            except UserError as error:
                return str(error)
        if self.bounds is None:
            return ''
        low, high = self.bounds
        whole = isinstance(self.default, int)
        if isinstance(value, bool) or not isinstance(value, int if whole else int | float) \
                or not low <= value <= high:
            kind = 'whole number' if whole else 'number'
            return f'{self.name} {value!r}: a {kind} from {low:g} to {high:g} is needed'
        return ''


SETTINGS = (
    Setting('model', '', 'model file that ~/prediction comes from; may be set while the node '
            'runs, and is swapped between two samples'),
    Setting('models', ('',), 'more model files, side by side on ~/NAME/prediction: NAME=PATH or '
            'PATH'),
    Setting('plant', '', 'plant that the models must be of; if not given, that of the model'),
    Setting('mode', 'observer', 'observer: from measured outputs up to the sample before, by a '
            'Kalman filter about the model; a model that lacks its noise runs one_step instead; '
            'one_step: likewise, by the difference equation; free_run: from the inputs alone; may '
            'be set while the node runs',
            choices=TWIN_MODES),
    Setting('horizon', 1, 'how many samples ahead ~/ahead predicts, in mode observer; may be set '
            'while the node runs', bounds=(1, 10_000)),
    Setting('follow', ('',), 'parameters that the observer follows as they change slowly, NAME or '
            'NAME=RATE, the relative change over the root of a second (0.05 by default); of an '
            'effect as ID@PORT:NAME; may be set while the node runs'),
    Setting('wait', 0.1, 'how long a late input is waited for before its last value is held [s]; '
            'may be set while the node runs', bounds=(0.0, 10.0)),
    Setting('sample_time', 0.0, 'clock of the offline verbs that read the same file [s]; the node '
            'takes that of its model, and refuses another; 0: not given', bounds=(0.0, 1e6)),
    Setting('autostart', True, 'configure and activate at the start; false leaves both to a '
            'lifecycle manager', read_only=True),
)
SIGNAL = 'signals.SIGNAL.{topic, type, field, scale, offset}'
SIGNAL_DESCRIPTION = 'where each signal of the plant is found; defaults as in config/PLANT.yaml'


def overview(settings: Sequence[Setting] = SETTINGS) -> str:
    """List the parameters of a node for `--help`."""
    import textwrap

    lines = []
    for name, default, about in [
            *((s.name, str(s.default).lower() if isinstance(s.default, bool) else s.default,
               s.description) for s in settings),
            (SIGNAL, '', SIGNAL_DESCRIPTION)]:
        said = about if default in ('', ('',)) else f'{about} (default: {default})'
        lines += [f'  {name}', *textwrap.wrap(said, 79, initial_indent=' ' * 6,
                                              subsequent_indent=' ' * 6)]
    return '\n'.join(lines)
