# SPDX-License-Identifier: Apache-2.0
"""Model predictive control on the compensated law, as a peer of the learned residual.

What a bench file says about a reference is simulated beforehand, with its coefficients held. What the force m differs
by from that, and what p within a_3 does, is linear about rest with the same numbers; f is the load's own force, d a
disturbance that is taken for a random walk::

    v = p' + K_p (p - m) + K_i int (p - m) + d             what the law asks of the valve
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
from typing import Any

import numpy as np
import numpy.typing as npt
import osqp
from scipy.linalg import expm, toeplitz
from scipy.sparse import csc_matrix

from benchmarks._model_based import Fixed
from hydro_bridge.serial.protocol import BoxLaw
from hydro_bridge.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, FloatArray
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.task.cases import Case
from hydro_sim.model import hydraulics
from hydro_sim.model.bench import Bench

STEPS, SPACING, BEGIN = 20, 5, 65
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
    a[1, :3] = -stiff / mass, -numbers.viscous_friction / mass, stiff / mass
    a[2, 1] = hydraulics.velocity_term(true, numbers.spring_rest_position, 1.0) / stiff
    a[2, 6] = input_ratio(true, box) * effects.get("valve_gain", {"ratio": 1.0})["ratio"]
    a[4, [0, 3, 4]] = w * w, -w * w, -2.0 * cell.get("damping", 1.0) * w
    a[5, [3, STATES]] = -law.base_ki, law.base_ki
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
        if self.steps < BEGIN:
            return np.zeros(len(active))
        window = slice(first + SAMPLES_PER_STEP, first + (STEPS + 1) * SAMPLES_PER_STEP)
        ahead = self._x @ self._a.T + self._last[:, np.newaxis] * self._b
        error = (self.wanted[:, window] - self._simulated[:, window])[:, SPACING - 1 :: SPACING]
        error = error - ahead @ self._free.T - self._last[:, np.newaxis] * self._driven
        plans = zip(error, self.coefficients[:, 3], self.added, strict=True)
        return np.array([self._first(*each) for each in plans]) * active

    def _first(self, error: FloatArray, level: float, added: float) -> float:
        """The correction with the first move of the best plan."""
        low, high = (np.repeat((limit[3] - level - added, side * self._rate), STEPS)
                     for limit, side in ((self._low, -1.0), (self._high, 1.0)))  # fmt: skip
        self._program.update(q=-self._moves.T @ error, l=np.minimum(low, 0.0), u=np.maximum(high, 0.0))
        return added + float(self._program.solve().x[0])
