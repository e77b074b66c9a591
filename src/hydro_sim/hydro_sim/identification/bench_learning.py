# SPDX-License-Identifier: Apache-2.0
"""Identification of the parameters of a bench file's effects and closures from recordings.

Each round has two steps: a Kalman filter with the present parameters gives initial states of windows of the recordings
(`bench_states`), then parameters and initial states are fitted to the windows jointly by Levenberg-Marquardt. In the
first rounds the filter assumes a large model error, so that a poor bench file does not mislead the initial states. A
reading whose error exceeds the noise is weighted by that error: the likelihood of five unknown variances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.files.recordings import Data, Run
from hydro_sim.identification import bench_states
from hydro_sim.identification.bench_states import Indices, Sensitivities, StateEstimator
from hydro_sim.identification.least_squares import damped_step
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import DEAD_TIME_PARAMETER, BenchModel
from hydro_sim.model.effects import catalogue, valve
from hydro_sim.model.equations import READINGS
from hydro_sim.model.quality import HORIZON_SAMPLES, Quality

PRIOR_WIDTH = 10.0
"""Prior standard deviation of a parameter about its value in the bench file: typical sizes, or factors of e."""
INITIAL_STATE_STEP_MAX = 4.0
"""Largest change of an initial state in one iteration, in standard deviations."""
COST_TOLERANCE = 1e-3
"""Share by which the cost must fall for another iteration."""
SUBSTEPS = 10
"""Integration steps per sample: 100 us, a 110th of a period of the 90 Hz mass-on-oil mode."""
MODEL_ERROR_SCHEDULE = (30.0, 10.0, 3.0, 1.0, 1.0, 1.0)
"""Scale of the model error that the filter assumes, by round."""
ITERATIONS = 5
"""Largest number of iterations in a round."""
MODEL_ERROR_SCALES = (0.03, 0.3, 3.0)
"""Scales of the model error for validation, of which the one with the lowest prediction error is chosen."""
DELAY_BOUND_MIN, DELAY_FACTOR = 5e-3, 2.0
"""Upper bound of a dead time: its smallest value [s], and its factor on the bench file's dead time."""
QUANTILE = 1.96
"""Half width of a 95 % interval in standard deviations."""


_USUAL_PARAMETERS = {
    "spring_stiffness": {"ratio": 1.0}, "supply_pressure": {"ratio": 1.0}, "valve_gain": {"ratio": 1.0},
    "bulk_modulus": {"ratio": 1.0}, "friction_viscous": {"coefficient": 0.0},
    "valve_lag": {"bandwidth": 100.0, "damping": 0.8}, "friction_coulomb": {"force": 10.0},
    "friction_stribeck": {"breakaway_force": 1.0, "velocity": 0.02}, "friction_presliding": {"stiffness": 2e5},
    "leakage_internal": {"coefficient": 0.0},
}  # fmt: skip
COMMON_EFFECTS: tuple[dict[str, Any], ...] = (
    *({"id": name, "parameters": parameters} for name, parameters in _USUAL_PARAMETERS.items()),
    {"id": "sensor_lag", "parameters": {"bandwidth": 30.0, "damping": 0.7}, "sensor": "load_force"},
)
"""Usual effects at typical values, which are identified if a bench file has none."""


@dataclass(frozen=True, kw_only=True)
class IdentifiedParameter:
    """Estimate of a parameter, with its 95 % interval."""

    name: str
    unit: str
    before: float
    """Value in the bench file."""
    value: float
    low: float
    """Lower end of the 95 % interval, as far as windows are independent and the model holds."""
    high: float
    informed: bool
    """Whether the recordings add to the prior."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """Result of an identification: the learned bench, its parameters' estimates and its prediction error."""

    bench: Bench
    parameters: list[IdentifiedParameter]
    noise: FloatArray
    """Noise of the readings, estimated from the recordings, shape (5,)."""
    rmse: FloatArray
    """RMSE of 70-sample predictions of the validation runs against the readings, shape (5,)."""

    @property
    def quality(self) -> Quality:
        """Quality of the learned bench."""
        return Quality.of((self.rmse / self.noise).tolist())

    def with_quality(self) -> Bench:
        """Return the learned bench with its measured quality."""
        return replace(self.bench, learned={"bench": self.bench.digest, **self.quality.to_mapping()})


def learn(
    bench: Bench, data: Data, *, count: int = 120, seed: int = 0, report: Callable[[str], None] = lambda text: None
) -> Result:
    """Return the bench with its effects' and closures' parameters fitted to `count` windows of the training runs.

    A bench file without effects gets `COMMON_EFFECTS`.
    """
    if not bench.terms:
        bench = replace(bench, load_cell_bandwidth=None, effects=COMMON_EFFECTS)
    exact = Sensitivities(BenchModel(with_longer_dead_times(bench), substeps=SUBSTEPS))
    parametrisation, noise = Parametrisation(bench, exact.model), bench_states.estimate_noise(data.training)
    places = [(i, begin) for i, run in enumerate(data.training) for begin in _window_begins(run, HORIZON_SAMPLES)]
    picked = np.random.default_rng(seed).choice(len(places), min(count, len(places)), replace=False)
    begins = ([places[j][1] for j in picked if places[j][0] == i] for i in range(len(data.training)))
    chosen = [np.sort(one).astype(np.int64) for one in begins]  # of each run, in rising order, without overlap
    q, weights, best = parametrisation.coordinates(parametrisation.values), noise, np.inf
    found, matrix = q, np.eye(len(q))  # of the round that predicts best
    for number, model_error in enumerate(MODEL_ERROR_SCHEDULE, 1):
        estimator = StateEstimator(exact, parametrisation.parameters(q), weights, model_error)
        fit = WindowFit(estimator, parametrisation, q, data.training, chosen)
        for _ in range(ITERATIONS):
            if not fit.iterate():
                break
        residual = np.sqrt(np.mean((np.array(fit.predictions(fit.q, fit.s)) - fit.targets) ** 2, axis=(0, 1)))
        q, weights = fit.q, np.maximum(noise, residual)
        report(f"round {number} of {len(MODEL_ERROR_SCHEDULE)}: error over noise {np.round(residual / noise, 3)}")
        if (error := float(np.mean(np.log(residual / noise)))) < best:
            best, found, matrix = error, q, fit.normal_equations()[0]
    theta, deviation = parametrisation.parameters(found), np.sqrt(np.diag(np.linalg.inv(matrix)))
    value, low, high = (
        parametrisation.free_parameters(found + side * QUANTILE * deviation) for side in (0.0, -1.0, 1.0)
    )
    parameters = [
        IdentifiedParameter(
            name=exact.model.parameters[index].name, unit=exact.model.parameters[index].unit,
            before=float(parametrisation.values[index]), value=float(value[i]), low=float(low[i]), high=float(high[i]),
            informed=bool(deviation[i] < 0.5 * PRIOR_WIDTH),
        )
        for i, index in enumerate(parametrisation.free)
    ]  # fmt: skip
    rmse, _ = best_prediction_rmse(exact, theta, noise, data.validation)
    return Result(bench=with_parameters(bench, theta), parameters=parameters, noise=noise, rmse=rmse)


class Parametrisation:
    """Parametrisation of a bench's model by scaled or logarithmic coordinates q of its free parameters.

    Free are the parameters of effects and closures except the bounds of a closure's table.
    """

    def __init__(self, bench: Bench, model: BenchModel) -> None:
        values = [value for effect in bench.terms for value in catalogue.parse_entry(effect)[1]]
        first, parameters = len(model.parameters) - len(values), model.parameters
        self.values: FloatArray = np.concatenate([model.values[:first], values])
        """All parameters of the model in the bench file, shape (parameters,)."""
        self.free = [
            i for i, one in enumerate(parameters)
            if i >= first and not (one.name.startswith("closure") and one.name.endswith((".low", ".high")))
        ]  # fmt: skip
        chosen = [parameters[i] for i in self.free]
        delays = max(sum(one.name == DEAD_TIME_PARAMETER for one in parameters), 1)
        longest = max(model.structure.past_currents - 2, 0) * SAMPLE_PERIOD / delays
        self.low = np.array([one.low for one in chosen])
        self.high = np.array([longest if one.name == DEAD_TIME_PARAMETER else one.high for one in chosen])
        self.scale = np.array([one.scale for one in chosen])
        self.logarithm = self.low > 0.0

    def parameters(self, q: FloatArray) -> FloatArray:
        """Return all parameters theta, shape (parameters,), at coordinates q, shape (free,)."""
        theta = self.values.copy()
        theta[self.free] = self.free_parameters(q)
        return theta

    def free_parameters(self, q: FloatArray) -> FloatArray:
        """Return the free parameters within their bounds, shape (free,)."""
        found = np.where(self.logarithm, np.exp(np.where(self.logarithm, q, 0.0)), self.scale * q)
        return np.asarray(np.clip(found, self.low, self.high))

    def coordinates(self, theta: FloatArray) -> FloatArray:
        """Return the coordinates q, shape (free,), of parameters theta, shape (parameters,)."""
        one = theta[self.free]
        return np.asarray(np.where(self.logarithm, np.log(np.where(self.logarithm, one, 1.0)), one / self.scale))


class WindowFit:
    """Least squares of parameters and initial states on windows of H samples, by Levenberg-Marquardt.

    The unknowns are q, shape (free,), and s, shape (n, estimated): deviations of the windows' initial states from the
    filter's estimates, in its standard deviations. `estimator`: that filter, whose noise weights the readings. `q`:
    initial value. `chosen`: first sample of each window, by run.
    """

    def __init__(
        self, estimator: StateEstimator, parametrisation: Parametrisation, q: FloatArray, runs: list[Run],
        chosen: list[Indices],
    ) -> None:  # fmt: skip
        self.estimator, self.exact, self.parametrisation = estimator, estimator.exact, parametrisation
        self.first, self.q, self.damping = parametrisation.coordinates(parametrisation.values), q, 1e-2
        pairs, steps = list(zip(runs, chosen, strict=True)), np.arange(HORIZON_SAMPLES)
        starts = [estimator.initial_states(run, samples) for run, samples in pairs]
        self.starts, self.roots = map(np.concatenate, zip(*starts, strict=True))
        self.currents = np.concatenate([run.u[at[:, None] + steps] for run, at in pairs])
        self.targets = np.concatenate([run.readings[at[:, None] + steps + 1] for run, at in pairs])
        self.s: FloatArray = np.zeros((len(self.starts), self.exact.estimated))

    def iterate(self) -> bool:
        """Run one iteration; return whether the cost still falls."""
        matrix, gradient, eliminated = self.normal_equations()
        cost = self.cost(self.q, self.s)
        reach = np.where(self.parametrisation.logarithm, 1.0, np.maximum(np.abs(self.q), 1.0))

        def attempt(change: FloatArray) -> tuple[tuple[FloatArray, FloatArray], float]:
            moved = self.q + np.clip(change, -reach, reach)
            q = self.parametrisation.coordinates(self.parametrisation.parameters(moved))
            moves = -(eliminated[:, :, -1] + eliminated[:, :, :-1] @ (q - self.q))
            s = self.s + np.clip(moves, -INITIAL_STATE_STEP_MAX, INITIAL_STATE_STEP_MAX)
            return (q, s), self.cost(q, s)

        found = damped_step(matrix, gradient, cost, attempt, self.damping, attempts=8)
        if found is None:
            return False
        (self.q, self.s), better, self.damping = found
        return better < (1.0 - COST_TOLERANCE) * cost

    def predictions(self, q: FloatArray, s: FloatArray) -> list[FloatArray]:
        """Return the readings of each window, shape (H, 5)."""
        k, _ = self.exact.coefficients(self.parametrisation.parameters(q))
        return [self.exact.model.rollout(k, self._start(i, one), self.currents[i]) for i, one in enumerate(s)]

    def cost(self, q: FloatArray, s: FloatArray) -> float:
        """Return the mean squared normalized error with priors; infinite if a prediction is not finite."""
        total = float(np.sum(s * s) + np.sum(((q - self.first) / PRIOR_WIDTH) ** 2))
        for z, target in zip(self.predictions(q, s), self.targets, strict=True):
            total += float(np.sum(((z - target) / self.estimator.noise) ** 2))
        return total / self.targets.size if np.isfinite(total) else np.inf

    def normal_equations(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return Gauss-Newton matrix and gradient in q with initial states eliminated, and the elimination's blocks.

        Shapes (free, free), (free,), and of A_i^-1 (B_i, a_i) (n, estimated, free + 1).
        """
        theta = self.parametrisation.parameters(self.q)
        k, dk = self.exact.coefficients(theta)
        slopes = np.where(self.parametrisation.logarithm, theta[self.parametrisation.free], self.parametrisation.scale)
        by_q = dk[:, self.parametrisation.free] * slopes
        estimated, count, noise = self.exact.estimated, len(self.q), self.estimator.noise
        eliminated = np.empty((len(self.s), estimated, count + 1))
        matrix = np.eye(count) / PRIOR_WIDTH**2
        gradient = (self.q - self.first) / PRIOR_WIDTH**2
        for i, s in enumerate(self.s):
            z, dz, _ = self.exact.window(k, self._start(i, s), self.currents[i], self.roots[i], by_q)
            error = ((z - self.targets[i]) / noise).ravel()
            rows = (dz / noise[:, None]).reshape(len(error), -1)
            by_s, by_parameters = rows[:, :estimated], rows[:, estimated:]
            b, a = by_s.T @ by_parameters, by_s.T @ error + s
            eliminated[i] = np.linalg.solve(by_s.T @ by_s + np.eye(estimated), np.column_stack([b, a]))
            matrix += by_parameters.T @ by_parameters - b.T @ eliminated[i, :, :-1]
            gradient = gradient + by_parameters.T @ error - b.T @ eliminated[i, :, -1]
        return matrix, gradient, eliminated

    def _start(self, i: int, s: FloatArray) -> FloatArray:
        y: FloatArray = self.starts[i].copy()
        y[: self.exact.estimated] += self.roots[i] @ s
        return y


def _window_begins(run: Run, stride: int) -> Sequence[int]:
    return range(min(bench_states.SETTLING_SAMPLES, len(run) // 4), len(run) - HORIZON_SAMPLES - 1, stride)


def best_prediction_rmse(
    exact: Sensitivities, theta: FloatArray, noise: FloatArray, runs: list[Run]
) -> tuple[FloatArray, StateEstimator]:
    """Return the lowest RMSE of 70-sample predictions over `MODEL_ERROR_SCALES`, shape (5,), and its filter."""
    found: list[tuple[FloatArray, StateEstimator]] = []
    for model_error in MODEL_ERROR_SCALES:
        estimator = StateEstimator(exact, theta, noise, model_error)
        squares, windows = np.zeros(len(READINGS)), 0
        for run in runs:
            states, readings = estimator.states(run), run.readings
            for begin in _window_begins(run, HORIZON_SAMPLES // 2):
                z = exact.model.rollout(estimator.k, states[begin].copy(), run.u[begin : begin + HORIZON_SAMPLES])
                squares += np.mean((z - readings[begin + 1 : begin + HORIZON_SAMPLES + 1]) ** 2, axis=0)
                windows += 1
        found.append((np.sqrt(squares / max(windows, 1)), estimator))
    return min(found, key=lambda one: float(np.mean(np.log(one[0]))))


def with_longer_dead_times(bench: Bench) -> Bench:
    """Return the bench with the longest allowed dead times: a model keeps as many past currents as these need."""
    effects = list(bench.effects)
    delays = [i for i, effect in enumerate(effects) if effect["id"] == valve.TransportDelay.id]
    for i in delays:
        time = max(DELAY_FACTOR * float(effects[i]["parameters"]["time"]), DELAY_BOUND_MIN)
        effects[i] = {**effects[i], "parameters": {"time": min(time, catalogue.DELAY_MAX / len(delays), 0.03)}}
    return replace(bench, effects=tuple(effects))


def with_parameters(bench: Bench, theta: FloatArray) -> Bench:
    """Return the bench with its effects' and closures' parameters set, rounded, to the last ones of theta."""
    kinds = [catalogue.parse_entry(effect)[0] for effect in bench.terms]
    rest = iter(theta[len(theta) - sum(len(kind.parameters) for kind in kinds) :])
    terms = [
        {**effect, "parameters": {one.name: float(f"{next(rest):.9g}") for one in kind.parameters}}
        for effect, kind in zip([*bench.effects, *bench.closures], kinds, strict=True)
    ]
    return replace(bench, effects=tuple(terms[: len(bench.effects)]), closures=tuple(terms[len(bench.effects) :]))
