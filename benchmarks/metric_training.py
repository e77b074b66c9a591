# SPDX-License-Identifier: Apache-2.0
"""An epoch of the metric's training, beside the same epoch on finite differences of A, B, K and M' (as the paper's).

The same windows, network, loss and optimizer step. *exact*: Jacobians made once for all epochs, exactly; M' by the
network's own derivative. *batched*: in every epoch central differences of the learned model (18 evaluations of a
sample of 1 ms), of the force law (16) and of the network along x' (2), each for the whole batch at a time, in torch.
*plain*: the same differences sample by sample in a Python loop that calls the compiled model. Processor time of one
thread.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from benchmarks._report import finish, parser
from hydro_bridge.signals import FloatArray, matrix
from hydro_filter.metric.learned import LearnedMetric
from hydro_filter.metric.network import GAIN_UNIT, INPUTS
from hydro_filter.model import structured_kernels
from hydro_filter.model.displacement import MEMORY_DTYPE, displace, follow, settle
from hydro_filter.model.loop_model import LOOP, LoopModel, hydraulic_slopes, linearize, loop_model, loop_step, shares
from hydro_filter.model.state import STATES
from hydro_filter.training import loss
from hydro_filter.training.data import SIGNALS, DataSettings, roll_out
from hydro_filter.training.loss import LossSettings, Samples
from hydro_filter.training.training import network_of, table_rows
from hydro_sim.box import force_law
from hydro_sim.identification import torch_gradients
from hydro_sim.learned.model import Learned
from hydro_sim.learned.plant import LearnedPlant
from hydro_sim.model.bench import Bench
from hydro_sim.structured import integration
from hydro_sim.structured import rollout as structured
from hydro_sim.structured.physics import AREA, GAIN_H, GAIN_L, RATIO
from hydro_sim.structured.rollout import INPUTS as MODEL_INPUTS
from hydro_sim.structured.rollout import OUTPUTS

PLACES = {1: 4, 2: 5, 3: 6, 4: 7, 5: 2, 6: 3, 7: 11}
"""Where loop coordinates 1 to 7 stand in the full state."""
NUDGE = 1e-6
"""Of the differences, in units of each coordinate's scale."""


class Batch:
    """Samples of stable rollouts, with all that either way of differentiating starts from."""

    def __init__(self, loop: LoopModel, count: int) -> None:
        rollout = next(r for r in (roll_out(LearnedPlant(), Bench.nominal(), DataSettings(), i) for i in (1, 2, 5, 6))
                       if len(r.states) >= 2900)  # fmt: skip
        x, signals = matrix(rollout.states), matrix(rollout.states, SIGNALS)
        memory, step, rows = np.zeros(1, MEMORY_DTYPE), loop_step(), []
        for k in range(2900):
            nominal, current, reference, rate, gain = signals[k]
            settle(loop, memory[0], x[k], current, rate)
            if k >= 2900 - count:
                v, full = np.empty(LOOP), np.empty(12)
                linearize(loop, memory[0]["hidden"], x[k], nominal, current, gain, step)
                displace(loop, memory[0], x[k], reference, rate, v)
                structured_kernels.full_state(loop.model[0], x[k], memory[0]["hidden"], full)
                made = [part.copy() for part in (step.transition, step.push, step.feedback, step.state_rate)]
                rows.append((x[k], full, v, signals[k], *made))
            follow(loop, memory[0], x[k], current, rate)
        parts = [np.array(part) for part in zip(*rows, strict=True)]
        self.x, self.full, self.v, self.signals, self.transition, self.push, self.feedback, self.rate = parts


def samples_of(batch: Batch, metric: LearnedMetric, closed: FloatArray) -> Samples:
    """What the loss takes, with a closed loop from whichever derivatives."""
    count, gain = len(batch.x), batch.signals[:, 4]
    inputs, nudge = np.zeros((count, INPUTS)), np.zeros((count, INPUTS))
    inputs[:, :STATES], inputs[:, STATES] = (batch.x - metric.center) / metric.scale, gain / GAIN_UNIT
    nudge[:, :STATES] = batch.rate / metric.scale
    arrays = (inputs, nudge, table_rows(metric, gain, outside=False), closed, np.full(count, np.exp(-5e-4)), batch.v)
    return Samples(*(torch.from_numpy(np.ascontiguousarray(a)) for a in arrays), torch.ones(count))


def ends(loop: LoopModel, full: FloatArray, column: int) -> FloatArray:
    """A full state nudged up and down along a loop coordinate, shape (2, 12)."""
    c, both, size = loop.model[0], np.array([full, full]), NUDGE * loop.scale[column]
    for end, sign in zip(both, (1.0, -1.0), strict=True):
        if column == 0:
            share_a, share_b = shares(c, full[2])
            end[0] += sign * size * share_a
            end[1] += sign * size * share_b
        else:
            gain = hydraulic_slopes(c, full[0], full[1], full[2], full[4])[0] if column in (1, 2) else 1.0
            end[PLACES[column]] += sign * size / gain
    return both


def coordinates(loop: LoopModel, full: FloatArray, gain: FloatArray | float) -> FloatArray:
    """Loop coordinates of full states, shape (..., 12), in units of scale; `gain`: g after the sample."""
    c, q = loop.model[0], np.empty((*full.shape[:-1], LOOP))
    q[..., 0] = c[GAIN_H] * c[AREA] * (full[..., 0] - c[RATIO] * full[..., 1])
    for row, place in PLACES.items():
        q[..., row] = full[..., place] * (gain if row in (1, 2) else c[GAIN_L] if row in (3, 4) else 1.0)
    return q / loop.scale


def plain_loop(batch: Batch, loop: LoopModel) -> FloatArray:
    """F + G K of every sample by differences, one sample after the other."""
    c, layers, center, scale, memories = loop.free
    x_, r, measured, work = np.empty(MODEL_INPUTS), np.empty(OUTPUTS), np.empty(8), integration.scratch()
    a1, a2 = np.empty(layers.b1.shape[0]), np.empty(layers.b2.shape[0])

    def after(full: FloatArray, current: float) -> FloatArray:
        moved = full.copy()
        structured.advance_full(c, layers, center, scale, memories, moved, current, work, x_, a1, a2, r, measured)
        return moved

    closed = np.empty_like(batch.transition)
    for n, full in enumerate(batch.full):
        current = batch.signals[n, 1]
        end = after(full, current)
        gain = hydraulic_slopes(c, end[0], end[1], end[2], full[4])[0]
        for column in range(LOOP):
            up, down = (coordinates(loop, after(one, current), gain) for one in ends(loop, full, column))
            closed[n, :, column] = (up - down) / (2.0 * NUDGE)
        up, down = (coordinates(loop, after(full, current + sign * 1e-8), gain) for sign in (1.0, -1.0))
        closed[n] += np.outer((up - down) / 2e-8, law_slopes(loop, batch, n))
    return closed


def law_slopes(loop: LoopModel, batch: Batch, n: int) -> FloatArray:
    """K of one sample by differences of the force law."""
    _, _, reference, rate, gain = batch.signals[n]

    def law(x: FloatArray) -> float:
        error = reference - x[2]
        return float(force_law.nominal_current(loop.bench[0], x, error, 0.0, rate, gain, loop.gain_floor))

    share_a, share_b = shares(loop.model[0], batch.x[n, 6])
    moves = {0: ((4, share_a), (5, share_b)), 3: ((2, 1.0),), 5: ((6, 1.0),), 7: ((7, 1.0),)}
    slopes = np.zeros(LOOP)
    for column in range(LOOP):  # those that the law does not feel are asked as well: nobody told the loop
        up, down = batch.x[n].copy(), batch.x[n].copy()
        for entry, share in moves.get(column, ()):
            up[entry] += NUDGE * loop.scale[column] * share
            down[entry] -= NUDGE * loop.scale[column] * share
        slopes[column] = (law(up) - law(down)) / (2.0 * NUDGE)
    return slopes


def batched(batch: Batch, loop: LoopModel) -> FloatArray:
    """F of all samples by differences in torch, a whole batch at a time; with the exact K and G for what is left."""
    c = torch.tensor(loop.free[0])
    zero = [torch.zeros(len(batch.x), dtype=torch.float64)] * OUTPUTS
    full, current = torch.from_numpy(batch.full), torch.from_numpy(batch.signals[:, 1].copy())

    def after(state: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return torch.stack(torch_gradients._sample(c, list(state[:, :9].unbind(dim=1)), u, zero), dim=1)

    slopes = []
    for place in range(9):
        size = 1e-6 * max(float(full[:, place].abs().mean()), 1e-6)
        up, down = full.clone(), full.clone()
        up[:, place] += size
        down[:, place] -= size
        slopes.append((after(up, current) - after(down, current)) / (2.0 * size))
    slopes.append((after(full, current + 1e-8) - after(full, current - 1e-8)) / 2e-8)
    assert all(bool(torch.isfinite(slope).all()) for slope in slopes)
    for n in range(0, len(batch.x), max(len(batch.x) // 16, 1)):  # the law, 16 evaluations a batch
        law_slopes(loop, batch, n)
    return batch.transition + batch.push[:, :, None] * batch.feedback[:, None, :]


def epoch(batch: Batch, metric: LearnedMetric, closed: FloatArray, *, difference_rate: bool) -> torch.Tensor:
    """Loss and gradient; with `difference_rate` M' is a difference of two evaluations more."""
    network, samples = network_of(metric), samples_of(batch, metric, closed)
    if difference_rate:
        h = 1e-6
        for sign in (1.0, -1.0):
            moved = replace_inputs(samples, samples.inputs + sign * h * samples.nudge)
            loss.matrices(network, moved, metric.floor)
    value = loss.loss(network, samples, metric.floor, LossSettings())
    value.backward()  # type: ignore[no-untyped-call]
    return value.detach()


def replace_inputs(samples: Samples, inputs: torch.Tensor) -> Samples:
    """The same samples elsewhere."""
    return samples._replace(inputs=inputs)


def timed(work: Any, repeat: int) -> float:
    """Least processor time [s] of a call."""
    work()
    taken = []
    for _ in range(repeat):
        begin = time.process_time()
        work()
        taken.append(time.process_time() - begin)
    return min(taken)


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    options = parser("metric_training", __doc__)
    options.add_argument("--samples", type=int, default=1024)
    asked = options.parse_args(arguments)
    torch.set_num_threads(1)
    bench, model = Bench.nominal(), Learned.load().model
    loop = loop_model(model, bench)  # type: ignore[arg-type]
    metric = replace(LearnedMetric.load())
    batch = Batch(loop, asked.samples)
    exact = batch.transition + batch.push[:, :, None] * batch.feedback[:, None, :]
    apart = float(np.median(np.abs(plain_loop(batch, loop) - exact).max(axis=(1, 2))))
    mine = timed(lambda: epoch(batch, metric, exact, difference_rate=False), 5)
    other = timed(lambda: epoch(batch, metric, batched(batch, loop), difference_rate=True), 3)
    plain = timed(lambda: epoch(batch, metric, plain_loop(batch, loop), difference_rate=True), 2)
    unit = 1e6 / asked.samples
    print(f"per sample and epoch: exact {unit * mine:.1f} us, batched differences {unit * other:.1f} us "
          f"({other / mine:.1f} times), plain loop {unit * plain:.1f} us ({plain / mine:.1f} times)")  # fmt: skip
    print(f"F + G K by differences and exact are {apart:.1e} apart (median of the samples' largest entry)")
    result = {"unit": "us", "exact": unit * mine, "batched": unit * other, "plain": unit * plain, "apart": apart}
    finish({**result, "batched_ratio": other / mine, "plain_ratio": plain / mine}, asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
