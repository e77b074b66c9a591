# SPDX-License-Identifier: Apache-2.0
"""Measured thresholds of a metric: v'Mv of sensor noise, and the integral action of stable loops.

Noise: the bench at rest with a closed valve, once with sensor noise and once without; the difference of both v, moved
by one sample as in the certificate. Integral: runs of an episode's length under stable gains; the value of I, with
friction, leakage and lags. A run's gains are constant, so that both forms of the integral agree.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from hydro_bridge.signals import PLANT_FIELDS, FloatArray, ReferenceSignal, StateArray, Waveform
from hydro_filter.controller.loop_decision import integral_term
from hydro_filter.metric.scheduled import ScheduledMetric
from hydro_filter.model.linearization import displace, linearize
from hydro_filter.model.loop import closing_current, memories, step_of
from hydro_filter.model.observer import follow, settle
from hydro_filter.model.parts import Loop
from hydro_filter.training.data import DataSettings
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

SAMPLES = 4000
QUANTILE = 0.99
"""Quantile of the noise's v'Mv that is treated as noise."""


def displacements(
    loop: Loop, plant: AnalyticPlant, gain: float, seed: int, velocity_compensation: float = 1.0
) -> FloatArray:
    """v_1 of a still bench, its valve closed, shape (samples, coordinates)."""
    x, memory, step, closing = plant.reset(seed), memories(), step_of(loop), closing_current(loop)
    out, scales = np.empty((SAMPLES, len(loop.scale))), (velocity_compensation, 1.0)
    for k in range(SAMPLES):
        settle(loop, memory[0], x, closing, 0.0)
        linearize(loop, memory[0]["hidden"], x, 1e-9, closing, gain, scales, step)
        displace(loop, memory[0], x, 0.0, 0.0, out[k])
        out[k] = (step.transition + np.outer(step.push, step.feedback)) @ out[k]
        follow(loop, memory[0], x, closing, 0.0)
        x = plant.step(closing)
    return out[100:]


def noise_sizes(metric: ScheduledMetric, loop: Loop, noisy: AnalyticPlant, clean: AnalyticPlant) -> tuple[float, float]:
    """`QUANTILE` of v'Mv of the noise: the largest over the certified range, and that of the metric for other gains."""
    sizes = []
    for gain in (metric.gains[0], float(np.median(metric.gains)), metric.gains[-1], np.inf):
        law = float(min(gain, metric.gains[-1]))
        v, still = (displacements(loop, each, law, 0, metric.velocity_compensation) for each in (noisy, clean))
        v = v - still
        matrix = metric.matrix(float(gain))
        sizes.append(float(np.quantile(np.einsum("ki,ij,kj->k", v, matrix, v), QUANTILE)))
    return max(sizes[:-1]), sizes[-1]


def integral_terms(loop: Loop, states: StateArray, velocity_compensation: float = 1.0) -> FloatArray:
    """I [N/s] of the force law, its coefficients neutral, at the samples of a run, shape (n,)."""
    out = np.empty(len(states))
    for k, record in enumerate(states):
        x = np.array([record[name] for name in PLANT_FIELDS])
        law = (record["reference_force"], record["reference_force_rate"], velocity_compensation, 1.0)
        numbers = record["nominal_valve_current"], record["proportional_gain"]
        out[k] = integral_term(loop.bench[0], loop.gain_floor, x, *numbers, law)[0]
    return out


ASKING = ((90.0, 15.0), (90.0, 30.0), (45.0, 30.0))
"""K_p [1/s], K_i [1/s^2] of the runs that measure the integral."""
ASKED_BY = (
    (Waveform.SINE, 2.0 / 3.0, 0.0, 1.0),
    (Waveform.SINE, 2.0 / 3.0, 0.5, 0.5),
    (Waveform.SINE, 2.0 / 3.0, -0.5, 0.5),
    (Waveform.MULTISINE, 1.0, 0.0, 1.0),
)
"""Their references: waveform, amplitude and offset over the bench's force, frequency [Hz]."""
ASKED_FOR = 18.0
"""s: the integral takes some K_p / K_i = 6 s to settle."""


def integral_allowance(loop: Loop, plant: AnalyticPlant, bench: Bench, data: DataSettings) -> float:
    """Largest integral action of stable loops under the law of `data` after the first second [N/s], plus a quarter."""
    largest = 0.0
    law, asking = data.compensated, list(ASKING)
    if law is not None:
        asking = [(law.base_kp, law.base_ki), *((s * law.base_kp, data.integral_gain_max) for s in (1.0, 0.5))]
    force, box = bench.size.force, data.box(bench)
    for gains, (waveform, amplitude, offset, frequency) in product(asking, ASKED_BY):
        reference = ReferenceSignal(
            waveform=waveform, amplitude=amplitude * force, offset=offset * force, frequency=frequency
        )
        plan = Schedule(reference=reference, gains=gains, seconds=ASKED_FOR, law=data.law)
        states = simulate(plant, bench, plan, config=box)
        terms = integral_terms(loop, states[1000:], data.velocity_compensation)
        largest = max(largest, float(np.abs(terms).max()))
    return 1.25 * largest
