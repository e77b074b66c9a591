# SPDX-License-Identifier: Apache-2.0
"""Parameters of a bench's effects, by Levenberg-Marquardt on many predictions, with exact derivatives.

Every window has its own start, which is estimated along with the parameters: start = guess + root s. s is drawn towards
0 with a standard deviation of 1, and is eliminated from the normal equations (a Schur complement)::

    min over q, s_1 .. s_n of   sum_i |(readings(q, s_i) - measured_i) / noise|^2 + |s_i|^2  +  |(q - q_0) / PRIOR|^2

    [ A_i  B_i ] [ ds_i ]     [ a_i ]             (C - sum_i B_i' A_i^-1 B_i) dq = -(c - sum_i B_i' A_i^-1 a_i)
    [ B_i' C   ] [ dq   ] = - [ c   ]

q are the parameters in their typical sizes, or the logarithm of those that cannot be 0 (`Coordinates`).
Source: Bock, 1987, on multiple shooting; the elimination as in bundle adjustment (Triggs et al., 2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.identification.bench_states import Indices
from hydro_sim.model.bench_model import Named
from hydro_sim.model.sensitivities import Sensitivities

PRIOR = 10.0
"""Prior standard deviation of a parameter about its value in the bench file: typical sizes, or factors of e."""
STEP_MAX = 1.0
"""Largest step of an iteration: a typical size, a factor of e, or all of a parameter larger than its typical size."""
START_MAX = 4.0
"""Largest step of s in one iteration."""
SETTLED = 1e-3
"""Share by which the cost must fall for another iteration."""


class Coordinates:
    """Parameters in sizes that can be compared.

    `parameters`: all of a model. `values`: values in the bench file, shape (parameters,). `free`: those that are
    learned.
    """

    def __init__(self, parameters: Sequence[Named], values: FloatArray, free: Indices) -> None:
        self.values, self.free = values, free
        chosen = [parameters[i] for i in free]
        self.low, self.high = (np.array([getattr(one, name) for one in chosen]) for name in ("low", "high"))
        self.scale = np.array([one.scale for one in chosen])
        self.logarithm = self.low > 0.0

    def theta(self, q: FloatArray) -> FloatArray:
        """All parameters."""
        theta = self.values.copy()
        theta[self.free] = self.one(q)
        return theta

    def one(self, q: FloatArray) -> FloatArray:
        """Return the free ones, held within their bounds."""
        found = np.where(self.logarithm, np.exp(np.where(self.logarithm, q, 0.0)), self.scale * q)
        return np.asarray(np.clip(found, self.low, self.high))

    def q(self, theta: FloatArray) -> FloatArray:
        """Coordinates q of the free parameters, given all."""
        one = theta[self.free]
        return np.asarray(np.where(self.logarithm, np.log(np.where(self.logarithm, one, 1.0)), one / self.scale))

    def magnitude(self, q: FloatArray) -> FloatArray:
        """Largest step of q: 1 at least, and |q| of a parameter that may be 0, which then doubles."""
        return np.asarray(np.where(self.logarithm, 1.0, np.maximum(np.abs(q), 1.0)))

    def slopes(self, q: FloatArray) -> FloatArray:
        """d theta/d q of the free ones."""
        return np.asarray(np.where(self.logarithm, self.one(q), self.scale))


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Windows, n of them, of H samples."""

    starts: FloatArray
    """First guesses, shape (n, states)."""
    roots: FloatArray
    """Shape (n, held, held)."""
    currents: FloatArray
    """A, shape (n, H)."""
    targets: FloatArray
    """Measured readings, shape (n, H, 5)."""
    noise: FloatArray
    """Deviations by which they are weighted, shape (5,)."""


@dataclass
class Fit:
    """State of the search."""

    q: FloatArray
    s: FloatArray
    """Shape (n, held)."""
    damping: float = 1e-2
    costs: list[float] = field(default_factory=list)
    """Mean squared error over noise per reading; 1 is what a perfect model leaves."""


class Problem:
    """Least-squares problem on a batch.

    `exact`: the model. `coordinates`: of its parameters. `batch`: windows.
    """

    def __init__(self, exact: Sensitivities, coordinates: Coordinates, batch: Batch) -> None:
        self.exact, self.coordinates, self.batch = exact, coordinates, batch
        self.first = coordinates.q(coordinates.values)
        self.size = batch.targets.size

    def improve(self, fit: Fit) -> bool:
        """Run one iteration in place; return whether another one is worthwhile."""
        reduced, gradient, back = self.normal(fit)
        cost = self.cost(fit.q, fit.s)
        reach = STEP_MAX * self.coordinates.magnitude(fit.q)
        while fit.damping < 1e8:
            damped = reduced + fit.damping * np.diag(np.diag(reduced))
            change = np.clip(-np.linalg.solve(damped, gradient), -reach, reach)
            q = self.coordinates.q(self.coordinates.theta(fit.q + change))
            moves = -(back[:, :, -1] + back[:, :, :-1] @ (q - fit.q))
            s = fit.s + np.clip(moves, -START_MAX, START_MAX)
            better = self.cost(q, s)
            if better < cost:
                fit.q, fit.s, fit.damping = q, s, max(fit.damping / 10.0, 1e-7)
                fit.costs.append(better)
                return better < (1.0 - SETTLED) * cost
            fit.damping *= 10.0
        return False

    def cost(self, q: FloatArray, s: FloatArray) -> float:
        """Mean squared error over noise, priors with it; infinite where a prediction is not finite."""
        k, _ = self.exact.coefficients(self.coordinates.theta(q))
        total = float(np.sum(s * s) + np.sum(((q - self.first) / PRIOR) ** 2))
        for i in range(len(s)):
            z = self.exact.model.rollout(k, self._start(i, s[i]), self.batch.currents[i])
            total += float(np.sum(((z - self.batch.targets[i]) / self.batch.noise) ** 2))
        return total / self.size if np.isfinite(total) else np.inf

    def left(self, fit: Fit) -> FloatArray:
        """RMS prediction error of each reading, shape (5,)."""
        k, _ = self.exact.coefficients(self.coordinates.theta(fit.q))
        found = [self.exact.model.rollout(k, self._start(i, s), self.batch.currents[i]) for i, s in enumerate(fit.s)]
        return np.asarray(np.sqrt(np.mean((np.array(found) - self.batch.targets) ** 2, axis=(0, 1))))

    def normal(self, fit: Fit) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Matrix and gradient by q, starts eliminated; and A_i^-1 (B_i, a_i), shape (n, held, free + 1)."""
        k, dk = self.exact.coefficients(self.coordinates.theta(fit.q))
        by_q = dk[:, self.coordinates.free] * self.coordinates.slopes(fit.q)
        held, count = self.exact.held, len(self.coordinates.free)
        back = np.empty((len(fit.s), held, count + 1))
        matrix = np.eye(count) / PRIOR**2
        gradient = (fit.q - self.first) / PRIOR**2
        for i, s in enumerate(fit.s):
            root, noise = self.batch.roots[i], self.batch.noise
            z, dz, _ = self.exact.window(k, self._start(i, s), self.batch.currents[i], root, by_q)
            error = ((z - self.batch.targets[i]) / noise).ravel()
            rows = (dz / noise[:, None]).reshape(len(error), -1)
            by_s, by_parameters = rows[:, :held], rows[:, held:]
            b, a = by_s.T @ by_parameters, by_s.T @ error + s
            back[i] = np.linalg.solve(by_s.T @ by_s + np.eye(held), np.column_stack([b, a]))
            matrix += by_parameters.T @ by_parameters - b.T @ back[i, :, :-1]
            gradient = gradient + by_parameters.T @ error - b.T @ back[i, :, -1]
        return matrix, gradient, back

    def _start(self, i: int, s: FloatArray) -> FloatArray:
        y = self.batch.starts[i].copy()
        y[: self.exact.held] += self.batch.roots[i] @ s
        return y
