# SPDX-License-Identifier: Apache-2.0
"""Training data of the metric: rollouts of the bench file with sensor noise, labelled, and a metric's thresholds.

A rollout is run twice with the same noise, the second time with a pulse of valve current after one second. **Label**:
the distance between the twins, largest |difference of f_l| in a window, early and late::

    stable      late < 0.6 early         unstable    late > early, or the box tripped       else: neither, not used

An overlap of the valve keeps the twins apart at small gains, by less the higher the gain, and at high gains it hides
instability. Where a bench has one, the label is UNSTABLE or that of the bench without it (`overlap_free`).

Gains are drawn from the whole range of the box; references are those of `hydro_sim.excitation`. Every rollout gives
windows of successive samples (paper: horizon H_m = 10), each with the exact F, G, K at the measured state, noise
included. None of these depends on the metric: they are computed once.

Thresholds are measured: v'Mv of sensor noise, and the integral action of stable loops. Noise: the bench at rest with a
closed valve, once with sensor noise and once without; the difference of both v, advanced by one sample as in the
certificate. Integral: runs of an episode's length under stable gains; the value of I, with friction, leakage and lags.
A run's gains are constant, so that both forms of the integral agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Annotated

import numpy as np
import numpy.typing as npt

from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.settings import quantity
from hydro_core.signals import Flag, FloatArray, Law, ReferenceSignal, StateArray, Waveform
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model.loop import Loop, closing_current, make_samples, recorded_samples
from hydro_filter.model.records import linearize
from hydro_sim import excitation
from hydro_sim.box.box import BoxConfig
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import Plant
from hydro_sim.simulation.offline import Schedule, simulate

STABLE, UNSTABLE, NEITHER = 1, -1, 0


@dataclass(frozen=True, kw_only=True)
class DataSettings:
    """Settings of the rollouts."""

    rollouts: Annotated[int, quantity("-", 8, 100000)] = 160
    """Number of rollouts."""
    seconds: Annotated[float, quantity("s", 2.0, 30.0)] = 3.0
    """Length of each rollout."""
    windows: Annotated[int, quantity("-", 1, 1000)] = 20
    """Windows of each rollout."""
    horizon: Annotated[int, quantity("-", 1, 100)] = 10
    """Successive samples of a window (Table training_metric)."""
    gain_min: Annotated[float, quantity("1/s", -40.0, 0.0)] = -40.0
    """Smallest K_p."""
    gain_max: Annotated[float, quantity("1/s", 1.0, 1e6)] = 300.0
    """Largest K_p."""
    integral_gain_min: Annotated[float, quantity("1/s^2", -5.0, 1e6)] = -5.0
    """Smallest K_i."""
    integral_gain_max: Annotated[float, quantity("1/s^2", 0.0, 1e6)] = 30.0
    """Largest K_i."""
    seed: Annotated[int, quantity("-", 0, 9e15)] = 0
    """Of gains, references and noise."""
    compensated: BoxLaw | None = None
    """The box's compensated law, under which they run; None: the paper's."""

    @classmethod
    def for_law(cls, law: BoxLaw, **settings: int) -> DataSettings:
        """Return the settings for a compensated law: gains from 0 to 1.25 times the law's limits."""
        return cls(
            compensated=law, gain_min=0.0, gain_max=1.25 * (law.base_kp + law.delta_kp_max),
            integral_gain_min=law.base_ki + law.delta_ki_min, integral_gain_max=law.base_ki + law.delta_ki_max,
            **settings,
        )  # fmt: skip

    def make_box_config(self, bench: Bench) -> BoxConfig:
        """Return a box configuration of this bench that admits all gains of the rollouts."""
        own, law = BoxConfig().of_bench(bench), self.compensated
        if law is None:
            return own
        return replace(own, compensated=replace(law, delta_kp_min=-law.base_kp, delta_kp_max=self.gain_max))

    @property
    def law(self) -> Law:
        """Force law of the rollouts."""
        return Law.PAPER if self.compensated is None else Law.COMPENSATED

    @property
    def velocity_compensation(self) -> float:
        """C_1 of the law."""
        return 1.0 if self.compensated is None else self.compensated.velocity_compensation


@dataclass(frozen=True, kw_only=True, eq=False)
class Rollout:
    """Rollout at fixed gains, up to a trip, with its stability label."""

    states: StateArray
    """Samples up to a trip of the box."""
    gains: tuple[float, float]
    label: int
    """STABLE, UNSTABLE or NEITHER."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """Windows of rollouts: n windows of H samples in c scaled loop coordinates."""

    transition: FloatArray
    """F, shape (n, H, c, c)."""
    input_vector: FloatArray
    """G [1/A], shape (n, H, c)."""
    feedback: FloatArray
    """K [A], shape (n, H, c)."""
    gain: FloatArray
    """K_p [1/s], shape (n,)."""
    label: npt.NDArray[np.int64]
    """Stability labels, shape (n,)."""

    def __len__(self) -> int:
        return len(self.gain)

    def subset(self, which: npt.NDArray[np.bool_]) -> Windows:
        """Return the windows selected by a mask, shape (n,)."""
        return Windows(**{name: array[which] for name, array in vars(self).items()})

    @classmethod
    def concatenate(cls, windows: Sequence[Windows]) -> Windows:
        """Return the concatenation of several sets of windows."""
        return cls(
            **{name: np.concatenate([getattr(one, name) for one in windows]) for name in cls.__dataclass_fields__}
        )


def roll_out(
    plant: Plant, bench: Bench, settings: DataSettings, index: int, overlap_free: Plant | None = None
) -> Rollout:
    """Run rollout number `index`, reproducible for equal settings; `overlap_free`: the plant without its overlap."""
    rng = np.random.default_rng((settings.seed, index))
    low, high = settings.gain_min, settings.gain_max
    edges = [(low, 0.0), (0.0, 0.4 * high), (0.0, 0.4 * high), (0.4 * high, high)][0 if low < 0.0 else 1 :]
    integral_gains = settings.integral_gain_min, settings.integral_gain_max
    gains = float(rng.uniform(*edges[index % len(edges)])), float(rng.uniform(*integral_gains))
    force = bench.size.force
    limits = replace(
        excitation.ExcitationRange.of_force(force), seconds=(4.0, 5.0), force_max=1.1 * force, offset_max=force / 3.0,
        frequency=(0.3, 3.0),
    )  # fmt: skip
    reference = excitation.draw_schedule(5.0, int(rng.integers(2**31)), limits)[0].signal
    seed = int(rng.integers(2**31))
    plan = Schedule(reference=reference, gains=gains, seconds=settings.seconds, law=settings.law)
    pulse = np.zeros(plan.samples)
    pulse[1000:1010] = 0.06 * bench.valve_current_max  # some 15 N on the nominal bench
    box = settings.make_box_config(bench)

    def twins(of: Plant) -> list[StateArray]:
        plans = [replace(plan, correction=correction) for correction in (np.zeros(plan.samples), pulse)]
        return [simulate(of, bench, each, config=box, seed=seed) for each in plans]

    first, second = twins(plant)
    label = stability_label(first, second)
    if overlap_free is not None and label != UNSTABLE:
        label = stability_label(*twins(overlap_free))
    trips = np.flatnonzero((first["flags"] & Flag.TRIPPED) != 0)
    kept = first[: trips[0]] if len(trips) else first
    return Rollout(states=kept, gains=gains, label=label)


def stability_label(first: StateArray, second: StateArray) -> int:
    """Return the stability label of two runs with equal gains, the second one disturbed by a pulse."""
    if any(((run["flags"] & Flag.TRIPPED) != 0).any() for run in (first, second)):
        return UNSTABLE
    distance = np.abs(first["load_force"] - second["load_force"])
    early, late = distance[1050:1350].max(), distance[-300:].max()
    return UNSTABLE if late > early else STABLE if late < 0.6 * early else NEITHER


def draw_windows(rollout: Rollout, loop: Loop, settings: DataSettings, seed: int) -> Windows | None:
    """Return windows at random times after the first 0.1 s, away from the end stops; None if there are none."""
    count, span = len(rollout.states), settings.horizon
    if count < 100 + 2 * span:
        return None
    starts = np.sort(np.random.default_rng(seed).integers(100, count - span, settings.windows))
    inside = starts[:, None] + np.arange(span)
    # a piston that rests on an end stop is not part of the loop
    position, stop = rollout.states["piston_position"], 0.00625 * loop["stroke"]
    free = (position > stop) & (position < loop["stroke"] - stop)
    inside = inside[free[inside].all(axis=1)]
    if not len(inside):
        return None
    linearized = np.zeros(count, np.bool_)
    linearized[inside] = True
    samples = recorded_samples(rollout.states, settings.velocity_compensation)
    found = linearize(loop.record, samples, linearized=linearized)
    rows = (np.cumsum(linearized) - 1)[inside]
    return Windows(
        transition=found.transition[rows], input_vector=found.input_vector[rows], feedback=found.feedback[rows],
        gain=np.full(len(inside), rollout.gains[0]), label=np.full(len(inside), rollout.label),
    )  # fmt: skip


def certified_range(rollouts: list[Rollout], low_reserve: float = 8.0) -> tuple[float, float]:
    """Return the range of K_p [1/s] in which the loop is stable without the filter.

    From `low_reserve` above the highest small gain without a stable rollout to 0.8 of the lowest large one, but not
    beyond the largest stable gain. Raises ValueError: no rollout is stable, or the range is empty.
    """
    stable = np.array([r.gains[0] for r in rollouts if r.label == STABLE])
    others = np.array([r.gains[0] for r in rollouts if r.label != STABLE])
    if not len(stable):
        raise ValueError("no rollout is stable: the bench file is not of this bench")
    middle = float(np.median(stable))
    low = max(float(others[others < middle].max(initial=0.0)), 0.0) + low_reserve
    high = min(0.8 * float(others[others > middle].min(initial=np.inf)), float(stable.max()))
    if not high > low:
        raise ValueError(f"no range of gains is stable with a reserve: {low:.0f} to {high:.0f} 1/s")
    return low, high


NOISE_QUANTILE = 0.99
"""Quantile of the noise's v'Mv that is the noise threshold."""


def rest_displacements(
    loop: Loop, plant: Plant, gain: float, seed: int, velocity_compensation: float = 1.0
) -> FloatArray:
    """Return the displacements v of a bench at rest with a closed valve, advanced by one sample; shape (samples, c)."""
    closing = closing_current(loop)
    x = np.array([plant.reset(seed), *(plant.step(closing) for _ in range(3999))])
    signals = {"nominal": 1e-9, "current": closing, "k_p": gain, "c_1": velocity_compensation}
    still = linearize(loop.record, make_samples(x, **signals))
    asked = np.einsum("ki,ki->k", still.feedback, still.displacement)
    moved = np.einsum("kij,kj->ki", still.transition, still.displacement) + asked[:, None] * still.input_vector
    return np.asarray(moved[100:], np.float64)


def noise_levels(metric: ScheduledMetric, loop: Loop, noisy: Plant, clean: Plant) -> tuple[float, float]:
    """Return the `NOISE_QUANTILE` of v'Mv of sensor noise: the largest of the certified range, and for other gains."""
    sizes = []
    for gain in (metric.gains[0], float(np.median(metric.gains)), metric.gains[-1], np.inf):
        law = float(min(gain, metric.gains[-1]))
        v, still = (rest_displacements(loop, each, law, 0, metric.velocity_compensation) for each in (noisy, clean))
        v = v - still
        matrix = metric.matrix(float(gain))
        sizes.append(float(np.quantile(np.einsum("ki,ij,kj->k", v, matrix, v), NOISE_QUANTILE)))
    return max(sizes[:-1]), sizes[-1]


INTEGRAL_TEST_REFERENCES = (
    (Waveform.SINE, 2.0 / 3.0, 0.0, 1.0),
    (Waveform.SINE, 2.0 / 3.0, 0.5, 0.5),
    (Waveform.SINE, 2.0 / 3.0, -0.5, 0.5),
    (Waveform.MULTISINE, 1.0, 0.0, 1.0),
)
"""References of the runs that measure the integral: waveform, amplitude and offset over the bench's force, Hz."""


def measure_integral_allowance(loop: Loop, plant: Plant, bench: Bench, data: DataSettings) -> float:
    """Return 1.25 times the largest integral [N/s] of stable loops under the law of `data` after the first second."""
    largest = 0.0
    law, asking = data.compensated, [(90.0, 15.0), (90.0, 30.0), (45.0, 30.0)]
    if law is not None:
        asking = [(law.base_kp, law.base_ki), *((s * law.base_kp, data.integral_gain_max) for s in (1.0, 0.5))]
    force, box = bench.size.force, data.make_box_config(bench)
    for gains, (waveform, amplitude, offset, frequency) in product(asking, INTEGRAL_TEST_REFERENCES):
        reference = ReferenceSignal(
            waveform=waveform, amplitude=amplitude * force, offset=offset * force, frequency=frequency
        )
        # the integral takes some K_p / K_i = 6 s to settle
        plan = Schedule(reference=reference, gains=gains, seconds=18.0, law=data.law)
        settled = recorded_samples(simulate(plant, bench, plan, config=box)[1000:], data.velocity_compensation)
        integral = linearize(loop.record, settled, linearized=np.zeros(len(settled), np.bool_)).integral
        largest = max(largest, float(np.abs(integral).max()))
    return 1.25 * largest
