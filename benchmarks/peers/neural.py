# SPDX-License-Identifier: Apache-2.0
"""A free-form residual: networks add to the three rates and to the two readings of the nominal bench.

Two layers of 32 tanh each, of position, velocity, both pressures and current. Trained in weak form (test functions
(1 - s^2)^4 of 50 ms), so that no noisy signal is differentiated and no simulation has to be differentiated through;
Adam with early stopping on the third recording. It names nothing.
"""

from __future__ import annotations

import copy

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view

from benchmarks.peers.run import DYNAMIC, READ, Corrected, Correction, Recordings, Signals, held_out, signals
from benchmarks.peers.weak import targets
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_sim.model.bench import Bench

HALF, STRIDE = 25, 5
"""Samples: half width of a test function, and between two of them."""
STEPS, BATCH, PATIENCE = 2500, 192, 8
INPUTS = ("position", "velocity", "pressure_a", "pressure_b", "current")
EQUATIONS = (*DYNAMIC, *READ)


def solve(case: Recordings, seed: int = 0) -> tuple[dict[str, list[str]], float]:
    """No names, and the held-out error over the noise floor."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    bench = Bench.nominal()
    parts = [_windows(model, bench) for model in case.fitted]
    inputs, left = (np.concatenate(side) for side in zip(*parts[:-1], strict=True))
    flat = inputs.reshape(-1, len(INPUTS))
    middle, spread = flat.mean(axis=0), flat.std(axis=0) + 1e-12
    scale = left.std(axis=0) + 1e-12
    network = _network()
    test = _bump() / np.sqrt(np.square(_bump()).sum())
    _train(network, (inputs - middle) / spread, left / scale, *_scaled(parts[-1], middle, spread, scale), test)
    gain = scale / np.sqrt(np.square(_bump()).sum()) / case.fitted[0].step
    plants = [Corrected.by(model, _correction(network, middle, spread, gain)) for model in case.held]
    return {}, held_out(plants, case.noise)


def _network() -> torch.nn.Module:
    layers = [torch.nn.Linear(len(INPUTS), 32), torch.nn.Tanh(), torch.nn.Linear(32, 32), torch.nn.Tanh()]
    last = torch.nn.Linear(32, len(EQUATIONS))
    torch.nn.init.zeros_(last.weight)
    torch.nn.init.zeros_(last.bias)
    return torch.nn.Sequential(*layers, last)


def _bump() -> FloatArray:
    at = np.arange(-HALF, HALF + 1) / (HALF + 1)
    return np.asarray((1.0 - at**2) ** 4)


def _slope(step: float) -> FloatArray:
    at = np.arange(-HALF, HALF + 1) / (HALF + 1)
    return np.asarray(-8.0 * at * (1.0 - at**2) ** 3 / ((HALF + 1) * step))


def _windows(model: SegmentModel, bench: Bench) -> tuple[FloatArray, FloatArray]:
    """Inputs, shape (windows, samples, 5), and weak integrals of what the nominal bench leaves, (windows, 5)."""
    along, left = signals(model), []
    for name, (state, nominal) in targets(model, bench).items():
        integrand = nominal if name in DYNAMIC else nominal - state
        weak = -_apply(integrand, _bump()) * model.step
        left.append(weak - _apply(state, _slope(model.step)) * model.step if name in DYNAMIC else weak)
    inputs = sliding_window_view(np.column_stack([along[name] for name in INPUTS]), 2 * HALF + 1, axis=0)
    keep = slice(model.settle, -model.settle, STRIDE)
    return inputs[keep].transpose(0, 2, 1), np.column_stack(left)[keep]


def _apply(signal: FloatArray, test: FloatArray) -> FloatArray:
    return sliding_window_view(signal, len(test)) @ test


def _scaled(part: tuple[FloatArray, FloatArray], middle: FloatArray, spread: FloatArray, scale: FloatArray
            ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    return (part[0] - middle) / spread, part[1] / scale


def _train(network: torch.nn.Module, inputs: FloatArray, left: FloatArray, unseen: FloatArray, unseen_left: FloatArray,
           test: FloatArray) -> None:  # fmt: skip
    """Adam with a falling rate; the network at the smallest error on the unseen recording stays."""
    x, y, px, py, w = (torch.tensor(np.ascontiguousarray(one), dtype=torch.float32)
                       for one in (inputs, left, unseen[::4], unseen_left[::4], test))  # fmt: skip
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS)
    best, kept, waited = float("inf"), copy.deepcopy(network.state_dict()), 0
    for step in range(STEPS):
        at = torch.randint(len(x), (BATCH,))
        loss = torch.mean((torch.einsum("wsk,s->wk", network(x[at]), w) - y[at]) ** 2)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % 100 == 99:
            with torch.no_grad():
                error = float(torch.mean((torch.einsum("wsk,s->wk", network(px), w) - py) ** 2))
            if error < best:
                best, kept, waited = error, copy.deepcopy(network.state_dict()), 0
            else:
                waited += 1
                if waited >= PATIENCE:
                    break
    network.load_state_dict(kept)


def _correction(network: torch.nn.Module, middle: FloatArray, spread: FloatArray, gain: FloatArray) -> Correction:
    weights = [(one.weight.detach().double().numpy(), one.bias.detach().double().numpy())
               for one in network if isinstance(one, torch.nn.Linear)]  # fmt: skip

    def correct(signal: Signals) -> dict[str, FloatArray]:
        value = np.stack(np.broadcast_arrays(*(signal[name] for name in INPUTS)), axis=-1)
        value = (value - middle) / spread
        for weight, bias in weights[:-1]:
            value = np.tanh(value @ weight.T + bias)
        value = (value @ weights[-1][0].T + weights[-1][1]) * gain
        return {name: value[..., k] for k, name in enumerate(EQUATIONS)}

    return correct
