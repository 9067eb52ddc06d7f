"""Twenty networks of 14-77-77-1 for 500 epochs, against torch.optim.Rprop one after another.

Run: python -m benchmarks.networks. Both sides train on the same 2985 patterns in single precision
from the same weights; that they reach the same errors is checked before any ratio is printed.
The time of starting the processes, each of which imports torch, counts on our side. Where torch
finds a GPU, the batched computation on it is timed too.
"""
from __future__ import annotations

from collections.abc import Callable
from functools import partial
import os
import resource
from time import perf_counter

import numpy as np
from scipy.stats import mannwhitneyu
import torch

from hydro_twin.fitting.network import (
    initial_weights,
    Job,
    Problem,
    train_batch,
    train_many,
)
from hydro_twin.fitting.rprop import (
    as_tensor,
    ETA_MINUS,
    ETA_PLUS,
    gradient,
    INITIAL_STEP,
    layers,
    MAX_STEP,
    MIN_STEP,
    rprop,
)
from hydro_twin.predictors.kind import Settings

NETS, PATTERNS = 20, 2985
SETTINGS = Settings(decay=0.0)


def made_up() -> Problem:
    """Draw patterns of a smooth function of 14 regressors, with noise."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(PATTERNS, 14))
    y = np.tanh(x[:, 0] * x[:, 1] + x[:, 2]) + 0.5 * np.sin(x[:, 3]) + x[:, 4]
    return Problem(x, 50.0 * y + rng.normal(size=PATTERNS), np.zeros(14), np.full(14, 3.0),
                   200.0, 1e4)


def one_after_another(problem: Problem) -> list[float]:
    """Train with torch's modules, autograd and Rprop on one thread; RMS after the last epoch."""
    torch.set_num_threads(1)
    x = torch.tensor((problem.regressors - problem.shift) / problem.scale, dtype=torch.float32)
    y = torch.tensor(problem.targets[:, None] / problem.output_scale, dtype=torch.float32)
    errors = []
    for seed in range(NETS):
        sizes = [14, *SETTINGS.hidden, 1]
        net = torch.nn.Sequential(torch.nn.Linear(14, 77), torch.nn.Tanh(),
                                  torch.nn.Linear(77, 77), torch.nn.Tanh(),
                                  torch.nn.Linear(77, 1))
        start = torch.tensor(initial_weights(sizes, seed), dtype=torch.float32)
        for i, (matrix, bias) in enumerate(layers(start[None], sizes)):
            net[2 * i].weight.data = matrix[0].T.contiguous()
            net[2 * i].bias.data = bias[0, 0].clone()
        optimizer = torch.optim.Rprop(net.parameters())
        for _ in range(SETTINGS.epochs):
            optimizer.zero_grad()
            loss = 0.5 * (net(x) - y).square().sum()
            loss.backward()
            optimizer.step()
        with torch.no_grad():
            error = problem.output_scale * (net(x) - y).square().mean().sqrt().item()
        errors.append(error)
    return errors


def ours(problem: Problem, device: str) -> list[float]:
    jobs = [Job(SETTINGS, seed) for seed in range(NETS)]
    return [float(np.sqrt(np.mean((t.network(problem.regressors) - problem.targets) ** 2)))
            for t in train_many(problem, jobs, device)]


def epochs(step: Callable[[torch.Tensor, torch.Tensor], Callable[[], object]], problem: Problem,
           count: int = 150) -> tuple[float, torch.Tensor]:
    """Train one network with the written-out gradient; seconds of processor, and the weights."""
    torch.set_num_threads(1)
    sizes = [14, *SETTINGS.hidden, 1]
    x, y = (as_tensor(a, 'cpu') for a in problem.scaled(problem))
    weights = as_tensor(initial_weights(sizes, 0)[None], 'cpu')
    slope = torch.empty_like(weights)
    move = step(weights, slope)
    begin = processor_time()
    for _ in range(count):
        gradient(weights, sizes, x[None], y[None, :, None], 0.0, slope)
        move()
    return processor_time() - begin, weights


def our_step(weights: torch.Tensor, slope: torch.Tensor) -> Callable[[], object]:
    return partial(rprop, weights, slope, torch.zeros_like(weights),
                   torch.full_like(weights, INITIAL_STEP))


def torch_step(weights: torch.Tensor, slope: torch.Tensor) -> Callable[[], object]:
    weights.grad = slope
    return torch.optim.Rprop([weights], lr=INITIAL_STEP, etas=(ETA_MINUS, ETA_PLUS),
                             step_sizes=(MIN_STEP, MAX_STEP)).step


def optimisers(problem: Problem) -> None:
    """Compare our step with that of torch.optim.Rprop, all else the same, turn about."""
    runs = [(epochs(our_step, problem), epochs(torch_step, problem)) for _ in range(5)]
    if not all(torch.equal(mine[1], theirs[1]) for mine, theirs in runs):
        raise SystemExit('torch.optim.Rprop gives other weights than our step')
    ratio = np.median([theirs[0] / mine[0] for mine, theirs in runs])
    print(f'an epoch with the step of torch.optim.Rprop: {ratio:.3f} of the time, same digits')


def processor_time() -> float:
    """Seconds of this process and of those it has ended: a fair measure on a shared machine."""
    usage = (resource.getrusage(who)
             for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in usage)


def timed(name: str, reference: tuple[float, list[float]] | None, work: object,
          *arguments: object) -> tuple[float, list[float]]:
    begin, before = perf_counter(), processor_time()
    errors = work(*arguments)               # type: ignore[operator]
    seconds = perf_counter() - begin
    line = (f'{name:45} {seconds:7.1f} s, {processor_time() - before:.1f} s of processor, '
            f'RMS {min(errors):.4f} ... {max(errors):.4f}')
    if reference is not None:
        p = mannwhitneyu(errors, reference[1]).pvalue
        if p < 0.01:
            raise SystemExit(f'{name}: errors differ from the reference beyond chance (p {p:.2g})')
        line += f', {reference[0] / seconds:.2f} times as fast, same errors (p {p:.2f})'
    print(line, flush=True)
    return seconds, errors


def main() -> None:
    problem = made_up()
    train_batch(problem, [Job(Settings(epochs=3), 0)])[0].network(problem.regressors[:2])
    optimisers(problem)
    reference = timed('torch.optim.Rprop, one after another', None, one_after_another, problem)
    cores = len(os.sched_getaffinity(0))
    timed(f'hydro_twin, {cores} processes', reference, ours, problem, 'cpu')
    if torch.cuda.is_available():
        train_batch(problem, [Job(Settings(epochs=3), 0)], 'cuda')
        timed(f'hydro_twin, batched on {torch.cuda.get_device_name()}', reference, ours, problem,
              'cuda')


if __name__ == '__main__':
    main()
