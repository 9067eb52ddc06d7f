"""A kind of predictor: what the registry holds of each, one file a kind."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hydro_twin.model import Model
    from hydro_twin.predictors.predictor import Predictor
    from hydro_twin.recording.series import Recording


@dataclass(frozen=True)
class Settings:
    """How a network is trained. The defaults are those of the MLP of [B19].

    Attributes:
        hidden: widths of the hidden layers.
        epochs: passes over all patterns.
        decay: weight decay, against the sum of squared scaled errors.
        cell: 'tanh' for an MLP, 'gru' for a recurrent network of one layer.
    """

    hidden: tuple[int, ...] = (77, 77)
    epochs: int = 500
    decay: float = 5e-4
    cell: str = 'tanh'

    @property
    def recurrent(self) -> bool:
        """Whether it keeps a state; then it has one hidden layer."""
        return self.cell == 'gru'


@dataclass(frozen=True)
class Fitted:
    """What a fit of weights returns: the predictor, and the content of its .safetensors file."""

    predictor: Predictor
    weights: bytes


@dataclass(frozen=True)
class Kind:
    """A kind of predictor.

    Attributes:
        name: what a model file and `--predictor` call it.
        title: for a sentence, with its article: 'an MLP'.
        make: makes the predictor of a model, whose weights lie in that folder; raises ModelError
            where they are missing or do not fit.
        physics: whether it has the physical parameters of its plant. They are fitted first.
        network: the network that is trained beside them, by `fitting.network`; None if it has
            none.
        fit: fits weights of another sort to a recording, given the model with its physical
            parameters and a seed; None if it has none.
    """

    name: str
    title: str
    make: Callable[[Model, Path], Predictor]
    physics: bool = True
    network: Settings | None = None
    fit: Callable[[Recording, Model, int], Fitted] | None = None

    @property
    def weights(self) -> bool:
        """Whether it has a file of weights, which know one sample time only."""
        return self.network is not None or self.fit is not None

    @property
    def analytical(self) -> bool:
        """Whether it is the physics and nothing else."""
        return self.physics and not self.weights
