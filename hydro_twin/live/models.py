"""The models that a node is asked to run, loaded and ready to step."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
import re

from hydro_twin.errors import ModelError
from hydro_twin.live.twin import MAIN, Twin
from hydro_twin.model import document, load_predictor
from hydro_twin.predictors import modes_of
from hydro_twin.recording.digest import source_of

HEAD_BYTES = 4096   # bytes at the begin of a model file that show whether it may be one


@dataclass(frozen=True)
class Choice:
    """A model to run: its name among the topics, '' for the main one, and its file."""

    name: str
    path: Path


def choices(model: str, models: Sequence[str]) -> list[Choice]:
    """List the models of the parameters `model` and `models` (each NAME=PATH or PATH).

    Raises:
        ModelError: none is given, or a name is no ROS name or there twice.
    """
    chosen = [Choice('', Path(model).expanduser())] if model else []
    for entry in filter(None, models):
        name, equals, path = entry.rpartition('=')
        file = Path(path).expanduser()
        name = name if equals else re.sub(r'\W', '_', file.stem)
        if not re.fullmatch(r'[A-Za-z]\w*', name):
            raise ModelError(f'models: {name!r} cannot name a topic; write NAME={file}')
        if name == MAIN:
            raise ModelError(f"models: {name} is the parameter 'model'; write OTHER_NAME={file}")
        if name in [choice.name for choice in chosen]:
            raise ModelError(f'models: {name} is there twice; write OTHER_NAME={file}')
        chosen.append(Choice(name, file))
    if not chosen:
        raise ModelError("no model is given: set the parameter 'model' to a model file, "
                         "as 'refit' writes it")
    return chosen


def load_twin(choice: Choice, mode: str, follow: Sequence[str] = ()) -> Twin:
    """Load a model, describe it, and compile its step; this takes its time.

    A model that lacks its noise, as one with a network, runs one_step in place of the observer.

    Args:
        choice: the model.
        mode: as asked for.
        follow: parameters that its observer is to follow, NAME or NAME=RATE; none: as it says.

    Raises:
        ModelError: the model cannot be used.
    """
    predictor = load_predictor(choice.path, follow=follow)
    if mode not in modes_of(predictor.model):
        mode = 'one_step'
    about = {'name': choice.name, 'path': str(choice.path),
             'sha256': source_of(choice.path).sha256, 'mode': mode, **document(predictor.model)}
    twin = Twin(choice.name, predictor, mode, about)
    twin.warm_up()
    return twin


def check_same_inputs(twin: Twin, other: Twin) -> None:
    """Refuse a twin that cannot run on the inputs of another.

    Raises:
        ModelError: it is of another plant, or of another sample time.
    """
    for what in ('plant.name', 'sample_time'):
        ours, theirs = twin.predictor, other.predictor
        for step in what.split('.'):
            ours, theirs = getattr(ours, step), getattr(theirs, step)
        if ours != theirs:
            raise ModelError(f'{what} is {ours}, that of the running model is {theirs}')


def plant_of(path: Path) -> str:
    """Look at a model file, in no time, for the name of its plant.

    Raises:
        ModelError: it cannot be read, or is no model file.
    """
    try:
        with path.open('rb') as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise ModelError(f'{path}: no model file can be read there ({error.strerror})') from None
    found = re.search(rb'^plant:\s*[\'"]?(\w+)', head, re.MULTILINE)
    if not found:
        raise ModelError(f'{path}: not a model file (no "plant" in it)')
    return found[1].decode()


def quick_refusal(path: Path, plant: str) -> str:
    """Look at a model file, in no time; the reason to refuse it, or ''."""
    try:
        found = plant_of(path)
    except ModelError as error:
        return str(error)
    return '' if found == plant else f'{path}: a model of {found}; the node runs {plant}'


def same_file(path: Path, twin: Twin) -> bool:
    """Say whether a file is still the one that a running twin was loaded from, or is gone."""
    try:
        return bool(source_of(path).sha256 == twin.about['sha256'])
    except OSError:
        return True
