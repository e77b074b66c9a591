# SPDX-License-Identifier: Apache-2.0
"""Peers that know what the compensated law's estimator has to find: certainty equivalence, and an oracle.

certainty equivalence  the coefficients, and the valve's terms, that the estimator finds on a simulation of a bench file
                       on the same reference; held (Astrom and Wittenmark 1995, Adaptive Control, chapter 1)
oracle                 those that it finds on the truth itself, on the same reference; held. From `RUNS` further runs of
                       it a_3 learns w <- w + 0.6 e, the error 12 ms ahead and smoothed with 8 ms (Bristow et al. 2006,
                       IEEE Control Systems 26(3), 96). The run that is measured has other noise
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d

from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.serial.protocol import BoxLaw
from hydro_bridge.signals import NEUTRAL, SAMPLE_PERIOD, SAMPLES_PER_STEP, FloatArray
from hydro_diagnosis.pipeline import diagnose
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.task.cases import Case, EvaluationSettings
from hydro_sim.box import reference
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import TruthConfig
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

LONGEST = 800
"""Policy steps of a run at most, and of what is looked at behind its end."""
GAIN, AHEAD, SMOOTHING, LARGEST = 0.6, 12, 8.0, 50.0
"""Share of the error that is learned, samples, samples, and N of a_3."""
BEGIN = np.clip((np.arange(LONGEST) - 60) / 40.0, 0.0, 1.0)
"""Of the learning, by policy step: the law arms first."""
RUNS = 5
"""That the oracle learns from."""

RECORDED = tuple(
    [Segment(seconds=10.0, waveform=waveform, amplitude=amplitude, frequency=0.5, kp=150.0, ki=15.0),
     Segment(seconds=10.0, waveform="sine", amplitude=200.0, frequency=frequency, kp=150.0, ki=15.0)]
    for waveform, amplitude, frequency in (("multisine", 200.0, 1.5), ("smooth_step", 150.0, 1.0))
)  # fmt: skip
"""What a diagnosis is given: to fit, and held out."""
CAUTIOUS = 1.6
"""Times the nominal valve's flow, which the box believes meanwhile: nothing trips."""

FORMS: dict[str, tuple[str, ...]] = {
    "spring_stiffness": ("ratio",), "supply_pressure": ("ratio",), "valve_gain": ("ratio",),
    "valve_gain_asymmetry": ("ratio",), "leakage_internal": ("coefficient",), "friction_coulomb": ("force",),
    "friction_stribeck": ("breakaway_force", "velocity"), "friction_presliding": ("stiffness",),
    "valve_lag": ("bandwidth", "damping"), "moving_mass": ("mass",), "valve_deadband": ("half_width",),
    "entrained_air": ("volume_fraction",),
}  # fmt: skip
"""Effects of the truths, with the parameters that the model's own forms have."""


class Fixed(Compensator):
    """Coefficients of another estimator, held; takes an estimator's place.

    `cases`: references of the n benches. `found`: the estimator.
    """

    def __init__(self, cases: Sequence[Case], found: Compensator) -> None:
        super().__init__(len(cases), law=BoxLaw())
        self._memory = found._memory
        self.frozen[:] = True
        times = np.arange(LONGEST * SAMPLES_PER_STEP) * SAMPLE_PERIOD
        self.wanted: FloatArray = np.array([reference.sample(case.signal, times)[0] for case in cases])
        """f_r [N], shape (n, samples)."""
        self.steps = 0
        """Policy steps since the begin."""
        self.added: FloatArray = np.zeros(len(cases))
        """Correction within a_3 [N], shape (n,)."""

    def step(
        self, commanded: FloatArray, measured: FloatArray, active: npt.NDArray[np.bool_],
        reference_rate: FloatArray | None = None,
    ) -> FloatArray:  # fmt: skip
        """See `Compensator.step`."""
        super().step(commanded, measured, active, reference_rate)
        self.steps += 1
        self.added = self.correction(commanded, measured, active)
        self.coefficients[:, 3] = np.clip(self.coefficients[:, 3] + self.added, self._low[3], self._high[3])
        return self.coefficients.copy()

    def correction(self, commanded: FloatArray, measured: FloatArray, active: npt.NDArray[np.bool_]) -> FloatArray:
        """Correction for the next policy step [N], shape (n,)."""
        return np.zeros(len(active))


class Oracle(Fixed):
    """The same with corrections that it learns from its runs; `learn` stands between two of them."""

    def __init__(self, cases: Sequence[Case], found: Compensator) -> None:
        super().__init__(cases, found)
        self._learned: FloatArray = np.zeros((len(cases), LONGEST))
        self._error: FloatArray = np.zeros((len(cases), LONGEST * SAMPLES_PER_STEP))

    def correction(self, commanded: FloatArray, measured: FloatArray, active: npt.NDArray[np.bool_]) -> FloatArray:
        """See `Fixed.correction`."""
        now = slice((self.steps - 1) * SAMPLES_PER_STEP + 1, self.steps * SAMPLES_PER_STEP + 1)
        self._error[:, now] = (self.wanted[:, now] - measured) * active[:, np.newaxis]
        return self._learned[:, self.steps] * active

    def learn(self) -> None:
        """Learn from the run that ended."""
        smooth = gaussian_filter1d(self._error, SMOOTHING, axis=1)
        middle = SAMPLES_PER_STEP * np.arange(LONGEST) + SAMPLES_PER_STEP // 2 + AHEAD
        self._learned += GAIN * BEGIN * smooth[:, np.minimum(middle, smooth.shape[1] - 1)]
        self._learned = np.clip(self._learned, -LARGEST, LARGEST)
        self._error[:], self.added[:], self.coefficients[:], self.steps = 0.0, 0.0, NEUTRAL, 0


def run(
    fleet: VectorBench, cases: Sequence[Case], settings: EvaluationSettings, seed: int, on: Compensator
) -> FloatArray:
    """Run the compensated law on these cases; measured force [N], shape (n, samples)."""
    steps = vector_runs.run(fleet, cases, vector_runs.fixed(np.zeros(2), (0.0, 0.0)), settings, seed, on)
    forces = [np.zeros((len(cases), 1)), *(step.samples["load_force"].copy() for step in steps)]
    return np.concatenate(forces, axis=1)


def simulation(bench: Bench, cases: Sequence[Case], noise: float = 1.0) -> VectorBench:
    """Simulate a bench, once for each case, its box believing the shipped bench.yaml."""
    return VectorBench([Bench.nominal()] * len(cases), [AnalyticPlant(bench, noise=noise) for _ in cases])


def known_bench(config: TruthConfig) -> Bench:
    """The nominal bench file with a truth's own parameters, as far as the model has them."""
    found = {name: getattr(config.effects, name) for name in FORMS}
    effects: list[dict[str, Any]] = [
        {"id": name, "parameters": {each: getattr(effect, each) for each in FORMS[name]}}
        for name, effect in found.items() if effect is not None
    ]  # fmt: skip
    effects += [
        {"id": "sensor_lag", "sensor": lag.sensor, "parameters": {"bandwidth": lag.bandwidth, "damping": lag.damping}}
        for lag in config.effects.sensor_lag
    ]
    return replace(Bench.nominal(), effects=tuple(effects))


def diagnosed_bench(config: TruthConfig) -> Bench:
    """The bench that `diagnose` makes of two recordings of 20 s on this truth, under the paper's law."""
    bench = Bench.nominal()
    believed = replace(bench, valve_nominal_flow=CAUTIOUS * bench.valve_nominal_flow)
    with TemporaryDirectory() as folder:
        bags = [Path(folder) / name for name in ("fitted", "held_out")]
        for seed, (bag, segments) in enumerate(zip(bags, RECORDED, strict=True)):
            with BagWriter(bag) as writer:
                writer.write_states(record_offline(config, segments, bench=believed, seed=seed).states)
        return diagnose(bags[:1], holdout=bags[1:]).corrected


def equivalent(bench: Bench, cases: Sequence[Case], settings: EvaluationSettings) -> Fixed:
    """Coefficients by a simulation of this bench."""
    found = Compensator(len(cases))
    run(simulation(bench, cases), cases, settings, 1, found)
    return Fixed(cases, found)


def foreseen(bench: Bench, cases: Sequence[Case], settings: EvaluationSettings, on: Fixed) -> FloatArray:
    """Measured force [N] of the coefficients on this bench without noise, shape (n, samples); f_r behind the end."""
    force = on.wanted.copy()
    made = run(simulation(bench, cases, 0.0), cases, settings, 1, Fixed(cases, on))
    force[:, : made.shape[1]] = made
    return force


def oracle(fleet: VectorBench, cases: Sequence[Case], settings: EvaluationSettings, runs: int = RUNS) -> Oracle:
    """What runs on the truth itself teach, each with other noise than the one that is measured."""
    found = Compensator(len(cases))
    run(fleet, cases, settings, 1, found)
    known = Oracle(cases, found)
    for seed in range(2, 2 + runs):
        run(fleet, cases, settings, seed, known)
        known.learn()
    return known
