"""Networks trained on recordings: one a core on a processor, all in one batch on a GPU."""
from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.errors import UserError
from hydro_twin.fitting.regression import regression, regressors
from hydro_twin.parallel import in_processes
from hydro_twin.plants import Plant
from hydro_twin.predictors import kinds
from hydro_twin.predictors.kind import Settings
from hydro_twin.predictors.network import Network
from hydro_twin.predictors.recurrent import Recurrent
from hydro_twin.recording.series import Series

if TYPE_CHECKING:
    from torch import Tensor

    from hydro_twin.fitting.rprop import Gradient, HeldOutError

# of the kinds of predictor that have a network, by name
SETTINGS = {name: kind.network for name, kind in kinds().items() if kind.network}
DIVERGED = 10.0         # a free run that exceeds the largest output trained on by this factor


@dataclass(frozen=True)
class Job:
    """One network to train.

    Attributes:
        seed: of the weights it starts from.
        rows: the patterns to train on; all where None.
    """

    settings: Settings
    seed: int
    rows: IntArray | None = None


@dataclass(frozen=True, eq=False)
class Trained:
    """A trained network, and its RMS before every epoch, shape (epochs,).

    Attributes:
        learning_curve: over the patterns it is trained on.
        held_out_curve: over those of another problem; nan where there is none.
    """

    network: Network
    learning_curve: FloatArray
    held_out_curve: FloatArray


@dataclass(frozen=True, eq=False)
class Problem:
    """What a network is to learn.

    Attributes:
        regressors: shape (N, R), in the plant's units, as in `regression.regressors`.
        targets: shape (N,).
        shift, scale: the network sees (regressors - shift) / scale, shape (R,).
        output_scale: it gives targets over this.
        limit: what its free run may not exceed.
        lengths: patterns of each stretch, one after the other; what is recurrent needs it.
    """

    regressors: FloatArray
    targets: FloatArray
    shift: FloatArray
    scale: FloatArray
    output_scale: float
    limit: float
    lengths: tuple[int, ...] = ()

    def network(self, settings: Settings, weights: FloatArray) -> Network:
        """Make a network of trained weights, shape (P,)."""
        sizes = np.array([len(self.shift), *settings.hidden, 1])
        kind = Recurrent if settings.recurrent else Network
        return kind(sizes, weights, self.shift, self.scale, self.output_scale, self.limit)

    def scaled(self, other: Problem) -> tuple[FloatArray, FloatArray]:
        """Scale regressors and targets of another problem, or of this one, for the network."""
        return (other.regressors - self.shift) / self.scale, other.targets / self.output_scale

    def error(self, network: Network, other: Problem) -> FloatArray:
        """Predict the targets of a problem; returns the errors, in their unit, shape (N,)."""
        begins = np.cumsum([0, *other.lengths[:-1]])
        predicted = [network(rows) for rows in np.split(other.regressors, begins[1:])]
        return np.concatenate(predicted) - other.targets


def make_problem(
    stretches: Sequence[Series], plant: Plant, predicted: Sequence[FloatArray] | None = None,
) -> Problem:
    """Collect the patterns of recordings, and the scaling of [B19].

    Past outputs are divided by the plant's output scale, inputs are (v - mean) / (3 std).

    Args:
        stretches: the samples.
        plant: names the signals, and gives the order.
        predicted: for a hybrid, the one-step prediction of every stretch, on whose error the
            network is trained; that error is divided by 3 std.

    Raises:
        DataError: the samples are too few, not finite or constant.
    """
    names, order = [signal.name for signal in plant.inputs], plant.order
    regression(stretches, plant.output.name, names, order)      # refuses what cannot be fitted
    rows = np.concatenate([block for series in stretches
                           for block in regressors(series, plant.output.name, names, order)])
    samples = [np.concatenate([series[name] for series in stretches]) for name in names]
    spread = [3.0 * column.std() or 1.0 for column in samples]
    y = rows[:, -1]
    targets, output_scale = y, plant.output_scale
    if predicted is not None:
        begin = order + 1
        targets = y - np.concatenate([column[begin:] for column in predicted])
        output_scale = 3.0 * float(targets.std()) or 1.0
    return Problem(
        np.ascontiguousarray(rows[:, :-1]), targets,
        np.concatenate([np.zeros(order), np.repeat([c.mean() for c in samples], order + 1)]),
        np.concatenate([np.full(order, plant.output_scale), np.repeat(spread, order + 1)]),
        output_scale, DIVERGED * float(np.abs(y).max()),
        tuple(len(series) - order - 1 for series in stretches if len(series) > order + 1))


def initial_weights(sizes: Sequence[int], seed: int) -> FloatArray:
    """Draw the weights of a fresh network, each from +-1/sqrt(inputs of its layer)."""
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.uniform(-1.0, 1.0, (rows + 1) * columns) / np.sqrt(rows)
                           for rows, columns in pairwise(sizes)])


def train_batch(
    problem: Problem, jobs: Sequence[Job], device: str = 'cpu',
    epoch_done: Callable[[], object] = lambda: None, held_out: Problem | None = None,
) -> list[Trained]:
    """Train networks of the same settings in one batched computation.

    The same job gives the same network to rounding, whatever batch it is in.

    Args:
        problem: what to learn.
        jobs: of the same settings, with rows of the same number.
        device: a torch device, 'cpu' or 'cuda'.
        epoch_done: called after every epoch.
        held_out: patterns to score before every epoch, which do not train.
    """
    from hydro_twin.fitting.rprop import train

    settings = jobs[0].settings
    run = _recurrent if settings.recurrent else _feedforward
    weights, gradient_of, held_out_error, patterns = run(problem, jobs, device, held_out)
    trained, *sums = train(gradient_of, weights, settings.epochs, device, epoch_done,
                           held_out_error)
    counts = patterns, len(held_out.targets) if held_out else 1
    curves = (problem.output_scale * np.sqrt(s / n) for s, n in zip(sums, counts, strict=True))
    return [Trained(problem.network(settings, w), *both)
            for w, *both in zip(trained, *curves, strict=True)]


def _feedforward(
    problem: Problem, jobs: Sequence[Job], device: str, held_out: Problem | None,
) -> tuple[FloatArray, Gradient, HeldOutError | None, int]:
    """Make ready the training of MLPs: initial weights, gradient, held-out error, patterns."""
    from hydro_twin.fitting.rprop import as_tensor, gradient, squares

    settings = jobs[0].settings
    x, y = problem.scaled(problem)
    sizes = [x.shape[1], *settings.hidden, 1]
    drawn = [job.rows for job in jobs if job.rows is not None]
    inputs, targets = (as_tensor(np.stack([a[rows] for rows in drawn]) if drawn else a[None],
                                 device).expand(len(jobs), *[-1] * a.ndim) for a in (x, y))
    others = [as_tensor(a[None], device).expand(len(jobs), *[-1] * a.ndim)
              for a in problem.scaled(held_out)] if held_out else []
    return (
        np.stack([initial_weights(sizes, job.seed) for job in jobs]),
        lambda weights, out: gradient(weights, sizes, inputs, targets[..., None], settings.decay,
                                      out),
        (lambda weights: squares(weights, sizes, others[0], others[1][..., None]))
        if held_out else None,
        inputs.shape[1])


def _recurrent(
    problem: Problem, jobs: Sequence[Job], device: str, held_out: Problem | None,
) -> tuple[FloatArray, Gradient, HeldOutError | None, int]:
    """Make ready the training of GRUs, as `_feedforward` does; on all patterns only."""
    from hydro_twin.fitting import recurrent
    from hydro_twin.fitting.rprop import as_tensor

    settings = jobs[0].settings
    sizes = [problem.regressors.shape[1], *settings.hidden, 1]

    def tensors(other: Problem) -> tuple[Tensor, Tensor, Tensor]:
        rows, scored = recurrent.windows(other.lengths)
        x, y = problem.scaled(other)
        return as_tensor(x[rows], device), as_tensor(y[rows], device), as_tensor(scored, device)

    trained, others = tensors(problem), tensors(held_out or problem)
    return (
        np.stack([recurrent.initial_weights(sizes, job.seed) for job in jobs]),
        lambda weights, out: recurrent.gradient(weights, sizes, *trained, settings.decay, out),
        (lambda weights: recurrent.squares(weights, sizes, *others)) if held_out else None,
        len(problem.targets))


def train_many(
    problem: Problem, jobs: Sequence[Job], device: str = 'cpu', held_out: Problem | None = None,
) -> Iterator[Trained]:
    """Train networks and yield them in the order of the jobs, using the whole machine.

    On a processor every core trains one network at a time on one thread, which beats batching;
    on a GPU neighbouring jobs of the same settings are one batch.

    Args:
        problem: what to learn.
        jobs: what to train; any settings.
        device: 'cpu', or a torch device such as 'cuda'.
        held_out: as in `train_batch`.

    Raises:
        UserError: there is no such device.
    """
    if device != 'cpu':
        check_device(device)
        for _, group in groupby(jobs, key=lambda job: job.settings):
            yield from train_batch(problem, list(group), device, held_out=held_out)
        return
    yield from in_processes(partial(_train_one, problem, held_out), jobs)


def check_device(name: str) -> None:
    """Refuse a device that torch cannot compute on.

    Raises:
        UserError: there is no such device on this machine.
        ModuleNotFoundError: torch is not installed.
    """
    if find_spec('torch') is None:
        raise ModuleNotFoundError("No module named 'torch'", name='torch')
    if name == 'cpu':
        return                              # without the seconds that importing torch takes
    from hydro_twin.fitting.rprop import computes_on

    if not computes_on(name):
        raise UserError(f'device {name!r}: torch cannot use it here; try cpu')


def _train_one(problem: Problem, held_out: Problem | None, job: Job) -> Trained:
    """Train one network by itself."""
    return train_batch(problem, [job], held_out=held_out)[0]
