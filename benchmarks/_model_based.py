# SPDX-License-Identifier: Apache-2.0
"""Peers that know what the compensated law's estimator has to find: certainty equivalence, an oracle, prediction.

certainty equivalence  the coefficients, and the valve's terms, that the estimator finds on a simulation of a bench file
                       on the same reference; held (Astrom and Wittenmark 1995, Adaptive Control, chapter 1)
oracle                 those that it finds on the truth itself, on the same reference; held. From `RUNS` further runs of
                       it a_3 learns w <- w + 0.6 e, the error 12 ms ahead and smoothed with 8 ms (Bristow et al. 2006,
                       IEEE Control Systems 26(3), 96). The run that is measured has other noise

Model predictive control on that law: what a bench file says about a reference is simulated beforehand, with its
coefficients held. What the force m differs by from that, and what p within a_3 does, is linear about rest with the same
numbers; f is the load's own force, d a disturbance that is taken for a random walk::

    v = p' + K_p (p - m) - K_i int m + d                   what the law asks of the valve
    s'' = w_v^2 (v - s) - 2 z_v w_v s'                     spool
    f_h' = g s - R f'                                      g, R: input gain over the believed one, h over the spring
    M f'' + b f' = k (f_h - f)
    m'' = w^2 (f - m) - 2 z w m'                           load cell

A Kalman filter follows m sample by sample. Every policy step the moves of p over the next 0.2 s of the reference are
planned, and the first is made (Qin and Badgwell 2003, Control Engineering Practice 11(7), 733)::

    min sum (f_r - m)^2 + rho sum (p_j - p_(j-1))^2        within the limits and the rate of a_3
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt
import osqp
from scipy.linalg import expm, toeplitz
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csc_matrix

from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import NEUTRAL_COEFFICIENTS, SAMPLE_PERIOD, SAMPLES_PER_STEP, FloatArray
from hydro_diagnosis.pipeline import diagnose
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.task.cases import Case, EvaluationSettings
from hydro_sim.box.firmware import reference_force
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import TruthConfig
from hydro_sim.excitation import Segment
from hydro_sim.model import equations, hydraulics
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
        law = BoxLaw()
        super().__init__(len(cases), law=law)
        self._memory, self._low, self._high = found._memory, law.coefficient_min[3], law.coefficient_max[3]
        self.frozen[:] = True
        times = np.arange(LONGEST * SAMPLES_PER_STEP) * SAMPLE_PERIOD
        self.wanted: FloatArray = np.array([reference_force(case.signal, times)[0] for case in cases])
        """f_r [N], shape (n, samples)."""
        self.steps = 0
        """Policy steps since the begin."""
        self.added: FloatArray = np.zeros(len(cases))
        """Correction within a_3 [N], shape (n,)."""

    def step(
        self, commanded: FloatArray, measured: FloatArray, active: npt.NDArray[np.bool_],
        reference_rate: FloatArray | None = None, reference: FloatArray | None = None,
    ) -> FloatArray:  # fmt: skip
        """See `Compensator.step`."""
        super().step(commanded, measured, active, reference_rate, reference)
        self.steps += 1
        self.added = self.correction(commanded, measured, active)
        self.coefficients[:, 3] = np.clip(self.coefficients[:, 3] + self.added, self._low, self._high)
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
        self._error[:], self.added[:], self.coefficients[:], self.steps = 0.0, 0.0, NEUTRAL_COEFFICIENTS, 0


def run(
    fleet: VectorBench, cases: Sequence[Case], settings: EvaluationSettings, seed: int, on: Compensator
) -> FloatArray:
    """Run the compensated law on these cases; measured force [N], shape (n, samples)."""
    steps = vector_runs.run(fleet, cases, vector_runs.fixed_gains(np.zeros(2), (0.0, 0.0)), settings, seed, on)
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


def oracle(fleet: VectorBench, cases: Sequence[Case], settings: EvaluationSettings) -> Oracle:
    """What runs on the truth itself teach, each with other noise than the one that is measured."""
    found = Compensator(len(cases))
    run(fleet, cases, settings, 1, found)
    known = Oracle(cases, found)
    for seed in range(2, 2 + RUNS):
        run(fleet, cases, settings, seed, known)
        known.learn()
    return known


STEPS, SPACING, WAIT = 20, 5, 65
"""Policy steps of the horizon; samples between the errors that count; policy steps after which it acts."""
NOISE = 0.6
"""N, standard deviation of the load cell."""
WEIGHTS = {
    "predictive_nominal": (3.0, 1000.0), "predictive_diagnosed": (3.0, 100.0), "predictive_known": (3.0, 100.0),
    "predictive_adaptive": (100.0, 300.0),
}  # fmt: skip
"""rho and standard deviation of d's change in a sample [N/s]: least error of a grid on four truths (--seed 5501)."""
STATES, MEASURED = 9, 3
"""f, f', f_h, m, m', int, s, s', d: how many, and which is measured."""


def loop_model(bench: Bench, law: BoxLaw) -> tuple[FloatArray, FloatArray]:
    """Transition over a sample, shape (9, 9), and inputs p and p' that are held meanwhile, shape (9, 2)."""
    numbers = bench.without_effects()
    effects = {
        each["id"]: each["parameters"] for each in bench.effects if each.get("sensor", "load_force") == "load_force"
    }
    true, box = numbers.constants()[0], Bench.nominal().constants()[0]
    stiff, mass = numbers.spring_stiffness, numbers.moving_mass
    cell = effects.get("sensor_lag", {"bandwidth": numbers.load_cell_bandwidth, "damping": math.sqrt(0.5)})
    spool = effects.get("valve_lag", {"bandwidth": 300.0, "damping": 1.0})
    w, w_v = (2.0 * math.pi * one["bandwidth"] for one in (cell, spool))
    a: FloatArray = np.zeros((STATES + 2, STATES + 2))
    a[0, 1] = a[3, 4] = a[6, 7] = 1.0
    stiffnesses = hydraulics.stiffnesses(true, numbers.spring_rest_position)
    a[1, :3] = -stiff / mass, -numbers.viscous_friction / mass, stiff / mass
    a[2, 1] = equations.force_rate(numbers, stiffnesses, (0.0, 0.0), 1.0) / stiff
    a[2, 6] = input_ratio(true, box) * effects.get("valve_gain", {"ratio": 1.0})["ratio"]
    a[4, [0, 3, 4]] = w * w, -w * w, -2.0 * cell.get("damping", 1.0) * w
    a[5, 3] = -law.base_ki
    a[7, [3, 5, 8, STATES, STATES + 1]] = w_v * w_v * np.array((-law.base_kp, 1.0, 1.0, law.base_kp, 1.0))
    a[7, 6:8] = -w_v * w_v, -2.0 * spool.get("damping", 1.0) * w_v
    moved = expm(a * SAMPLE_PERIOD)
    return moved[:STATES, :STATES], moved[:STATES, STATES:]


def input_ratio(true: Any, box: Any) -> float:
    """Input gain over the one that the box believes, mean of both directions, at the pressures of steady motion."""
    cube, supply = true["area_ratio"] ** 3, true["supply_pressure"]
    ratios = []
    for opening, pressure_b in ((1.0, supply * true["area_ratio"] ** 2 / (1.0 + cube)), (-1.0, supply / (1.0 + cube))):
        at = true["spring_rest_position"], true["area_ratio"] * pressure_b, pressure_b, opening
        ratios.append(hydraulics.input_gain(true, *at) / hydraulics.input_gain(box, *at))
    return float(np.mean(ratios))


def kalman_gain(transition: FloatArray, drift: float) -> FloatArray:
    """Gain of the filter after 5 s, shape (9,)."""
    spread = np.diag(np.append(np.full(STATES - 1, 1e-4), drift**2))
    covariance = spread
    for _ in range(5000):
        gain = covariance[:, MEASURED] / (covariance[MEASURED, MEASURED] + NOISE**2)
        covariance = transition @ (covariance - np.outer(gain, covariance[MEASURED])) @ transition.T + spread
    return gain


class Predictive(Fixed):
    """The controller by the numbers of a bench file.

    `found`: coefficients on which it acts. `simulated`: measured force [N] of a run on the file, shape (n, samples);
    None: the reference, and the coefficients go on being estimated. `weights`: of `WEIGHTS`.
    """

    def __init__(
        self, cases: Sequence[Case], found: Compensator, bench: Bench, weights: tuple[float, float],
        simulated: FloatArray | None = None,
    ) -> None:  # fmt: skip
        super().__init__(cases, found)
        law, n, samples = BoxLaw(), STATES, STEPS * SAMPLES_PER_STEP
        self.frozen[:] = simulated is not None
        self._simulated = self.wanted if simulated is None else simulated
        transition, inputs = loop_model(bench, law)
        self._a = np.block([[transition, -inputs[:, 1:] / SAMPLE_PERIOD], [np.zeros((1, n + 1))]])
        self._b = np.append(inputs[:, 0] + inputs[:, 1] / SAMPLE_PERIOD, 1.0)  # the last state is p before
        self._gain = np.append(kalman_gain(transition, weights[1]), 0.0)
        rows = [np.eye(n + 1)[MEASURED]]
        for _ in range(samples - 1):
            rows.append(rows[-1] @ self._a)
        driven = toeplitz(np.append(0.0, np.array(rows) @ self._b)[:-1], np.zeros(samples))
        self._ones = np.tril(np.ones((STEPS, STEPS)))
        moves = driven @ np.kron(self._ones, np.ones((SAMPLES_PER_STEP, 1)))
        at = slice(SPACING - 1, None, SPACING)
        self._free, self._driven, self._moves = np.array(rows)[at], driven[at].sum(axis=1), moves[at]
        self._x: FloatArray = np.zeros((len(cases), n + 1))
        self._last: FloatArray = np.zeros(len(cases))
        self._rate = law.coefficient_rate[3] * SAMPLES_PER_STEP * SAMPLE_PERIOD
        self._program, bound = osqp.OSQP(), np.zeros(2 * STEPS)
        hessian = csc_matrix(np.triu(self._moves.T @ self._moves + weights[0] * np.eye(STEPS)))
        limited = csc_matrix(np.concatenate((self._ones, np.eye(STEPS))))
        self._program.setup(hessian, np.zeros(STEPS), limited, bound, bound, verbose=False)

    def correction(self, commanded: FloatArray, measured: FloatArray, active: npt.NDArray[np.bool_]) -> FloatArray:
        """See `Fixed.correction`."""
        first = (self.steps - 1) * SAMPLES_PER_STEP + 1
        for k in range(SAMPLES_PER_STEP):
            self._x = self._x @ self._a.T + self._last[:, np.newaxis] * self._b
            seen = measured[:, k] - self._simulated[:, first + k]
            self._x += (seen - self._x[:, MEASURED])[:, np.newaxis] * self._gain
            self._last = self.added
        if self.steps < WAIT:
            return np.zeros(len(active))
        window = slice(first + SAMPLES_PER_STEP, first + (STEPS + 1) * SAMPLES_PER_STEP)
        ahead = self._x @ self._a.T + self._last[:, np.newaxis] * self._b
        error = (self.wanted[:, window] - self._simulated[:, window])[:, SPACING - 1 :: SPACING]
        error = error - ahead @ self._free.T - self._last[:, np.newaxis] * self._driven
        plans = zip(error, self.coefficients[:, 3], self.added, strict=True)
        return np.array([self._first(*each) for each in plans]) * active

    def _first(self, error: FloatArray, level: float, added: float) -> float:
        """The correction with the first move of the best plan."""
        low, high = (np.repeat((limit - level - added, side * self._rate), STEPS)
                     for limit, side in ((self._low, -1.0), (self._high, 1.0)))  # fmt: skip
        self._program.update(q=-self._moves.T @ error, l=np.minimum(low, 0.0), u=np.maximum(high, 0.0))
        return added + float(self._program.solve().x[0])
