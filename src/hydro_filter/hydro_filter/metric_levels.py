# SPDX-License-Identifier: Apache-2.0
"""The thresholds of a metric, measured: what of v'Mv is the sensors' noise, and what stable loops ask of the integral.

Noise: the still bench with a closed valve, once with its sensors' noise and once without; the difference of both v, moved by
one sample as the certificate moves it. Integral: rollouts under gains of the certified range; what K_i int e dt asks for, friction,
leakage and lags in it.
"""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import PLANT_FIELDS, FloatArray, StateArray
from hydro_filter import displacement
from hydro_filter.displacement import MEMORY_DTYPE
from hydro_filter.learned_metric import LearnedMetric
from hydro_filter.loop_decision import integral_term
from hydro_filter.metric_data import STABLE, Rollout
from hydro_filter.loop_model import LOOP, LoopModel, linearize, loop_step
from hydro_sim.plant import Plant

SAMPLES = 4000
QUANTILE = 0.99
"""Of the noise's v'Mv: what is taken for noise."""


def displacements(loop: LoopModel, plant: Plant, gain: float, seed: int) -> FloatArray:
    """v_1 of a still bench, its valve closed, shape (samples, 8)."""
    x, memory, step = plant.reset(seed), np.zeros(1, MEMORY_DTYPE), loop_step()
    out = np.empty((SAMPLES, LOOP))
    for k in range(SAMPLES):
        displacement.settle(loop, memory[0], x, 0.0, 0.0)
        linearize(loop, memory[0]["hidden"], x, 1e-9, 0.0, gain, step)
        displacement.displace(loop, memory[0], x, 0.0, 0.0, out[k])
        out[k] = (step.transition + np.outer(step.push, step.feedback)) @ out[k]
        displacement.follow(loop, memory[0], x, 0.0, 0.0)
        x = plant.step(0.0)
    return out[100:]


def noise_sizes(
    metric: LearnedMetric, loop: LoopModel, noisy: Plant, clean: Plant, seed: int = 0
) -> tuple[float, float]:
    """`QUANTILE` of v'Mv of the noise: the largest over the certified range, and that of the metric for other gains."""
    x, sizes = clean.reset(seed), []
    for gain in (metric.gains[0], float(np.median(metric.gains)), metric.gains[-1], np.inf):
        law = float(min(gain, metric.gains[-1]))
        v = displacements(loop, noisy, law, seed) - displacements(loop, clean, law, seed)
        matrix = metric.matrix(x, float(gain))
        sizes.append(float(np.quantile(np.einsum("ki,ij,kj->k", v, matrix, v), QUANTILE)))
    return max(sizes[:-1]), sizes[-1]


def integral_terms(loop: LoopModel, states: StateArray) -> FloatArray:
    """K_i int e dt [N/s] at the samples of a run, shape (n,)."""
    out = np.empty(len(states))
    for k, record in enumerate(states):
        x = np.array([record[name] for name in PLANT_FIELDS])
        law = (record["nominal_valve_current"], record["reference_force"], record["reference_force_rate"])
        out[k] = integral_term(loop.bench[0], loop.gain_floor, x, *law, record["proportional_gain"])[0]
    return out


def integral_allowance(loop: LoopModel, rollouts: list[Rollout], gains: FloatArray) -> float:
    """Largest that a stable rollout's integral asked for after its first half second [N/s]."""
    low, high = gains[0], gains[-1]
    wanted = [run for run in rollouts if run.label == STABLE and low <= run.gains[0] <= high]
    return float(max(np.abs(integral_terms(loop, run.states[500:])).max() for run in wanted))
