# SPDX-License-Identifier: Apache-2.0
"""Learns the parameters of a bench file's effects and closures from recordings.

Each round has two halves: the filter follows the recordings with the present parameters and gives the start states of
windows (`bench_states`), then parameters and starts are fitted to the windows together by Levenberg-Marquardt. At first
the filter trusts the model little, so that a poor bench file does not mislead the starts. A reading whose error exceeds
the noise is weighted by that error: the likelihood of five unknown variances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.files.recordings import Data, Run
from hydro_sim.identification.bench_states import (
    SETTLING_SAMPLES,
    Indices,
    Sensitivities,
    StateEstimator,
    estimate_noise,
)
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import DEAD_TIME, READINGS, BenchModel
from hydro_sim.model.effects import catalogue, valve
from hydro_sim.model.effects.base import Parameter
from hydro_sim.model.quality import HORIZON, Quality

PRIOR_WIDTH = 10.0
"""Prior standard deviation of a parameter about its value in the bench file: typical sizes, or factors of e."""
STEP_MAX = 1.0
"""Largest step of an iteration: a typical size, a factor of e, or all of a parameter larger than its typical size."""
START_MAX = 4.0
"""Largest step of s in one iteration."""
COST_TOLERANCE = 1e-3
"""Share by which the cost must fall for another iteration."""


class Parametrization:
    """Parametrization of the free parameters by scaled or logarithmic coordinates q.

    `parameters`: all of a model. `values`: values in the bench file, shape (parameters,). `free`: those that are
    learned.
    """

    def __init__(self, parameters: Sequence[Parameter], values: FloatArray, free: Indices) -> None:
        self.values, self.free = values, free
        chosen = [parameters[i] for i in free]
        self.low, self.high = (np.array([getattr(one, name) for one in chosen]) for name in ("low", "high"))
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

    def step_max(self, q: FloatArray) -> FloatArray:
        """Return the largest step of q per iteration, shape (free,): 1, or |q| where larger and not logarithmic."""
        return np.asarray(np.where(self.logarithm, 1.0, np.maximum(np.abs(q), 1.0)))

    def derivative(self, q: FloatArray) -> FloatArray:
        """Return d theta/d q of the free parameters, shape (free,)."""
        return np.asarray(np.where(self.logarithm, self.free_parameters(q), self.scale))


@dataclass(frozen=True, kw_only=True)
class WindowBatch:
    """Batch of n windows of H samples."""

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
class FitState:
    """State of the least-squares iteration."""

    q: FloatArray
    s: FloatArray
    """Shape (n, held)."""
    damping: float = 1e-2
    costs: list[float] = field(default_factory=list)
    """Mean squared error over noise per reading; 1 is what a perfect model leaves."""


class LeastSquaresProblem:
    """Least-squares problem on a batch.

    `exact`: the model. `coordinates`: of its parameters. `batch`: windows.
    """

    def __init__(self, exact: Sensitivities, coordinates: Parametrization, batch: WindowBatch) -> None:
        self.exact, self.coordinates, self.batch = exact, coordinates, batch
        self.first = coordinates.coordinates(coordinates.values)
        self.size = batch.targets.size

    def iterate(self, fit: FitState) -> bool:
        """Run one Levenberg-Marquardt iteration in place; return whether the cost still falls."""
        matrix, gradient, eliminated = self.normal_equations(fit)
        cost = self.cost(fit.q, fit.s)
        reach = STEP_MAX * self.coordinates.step_max(fit.q)
        while fit.damping < 1e8:
            damped = matrix + fit.damping * np.diag(np.diag(matrix))
            change = np.clip(-np.linalg.solve(damped, gradient), -reach, reach)
            q = self.coordinates.coordinates(self.coordinates.parameters(fit.q + change))
            moves = -(eliminated[:, :, -1] + eliminated[:, :, :-1] @ (q - fit.q))
            s = fit.s + np.clip(moves, -START_MAX, START_MAX)
            better = self.cost(q, s)
            if better < cost:
                fit.q, fit.s, fit.damping = q, s, max(fit.damping / 10.0, 1e-7)
                fit.costs.append(better)
                return better < (1.0 - COST_TOLERANCE) * cost
            fit.damping *= 10.0
        return False

    def cost(self, q: FloatArray, s: FloatArray) -> float:
        """Return the mean squared normalized error with priors; infinite if a prediction is not finite."""
        k, _ = self.exact.coefficients(self.coordinates.parameters(q))
        total = float(np.sum(s * s) + np.sum(((q - self.first) / PRIOR_WIDTH) ** 2))
        for i in range(len(s)):
            z = self.exact.model.rollout(k, self._start(i, s[i]), self.batch.currents[i])
            total += float(np.sum(((z - self.batch.targets[i]) / self.batch.noise) ** 2))
        return total / self.size if np.isfinite(total) else np.inf

    def residual_rms(self, fit: FitState) -> FloatArray:
        """Return the RMS prediction error of each reading, shape (5,), in its unit."""
        k, _ = self.exact.coefficients(self.coordinates.parameters(fit.q))
        found = [self.exact.model.rollout(k, self._start(i, s), self.batch.currents[i]) for i, s in enumerate(fit.s)]
        return np.asarray(np.sqrt(np.mean((np.array(found) - self.batch.targets) ** 2, axis=(0, 1))))

    def normal_equations(self, fit: FitState) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return Gauss-Newton matrix and gradient in q with initial states eliminated, and the elimination's blocks.

        Shapes (free, free), (free,), and of A_i^-1 (B_i, a_i) (n, held, free + 1).
        """
        k, dk = self.exact.coefficients(self.coordinates.parameters(fit.q))
        by_q = dk[:, self.coordinates.free] * self.coordinates.derivative(fit.q)
        held, count = self.exact.held, len(self.coordinates.free)
        eliminated = np.empty((len(fit.s), held, count + 1))
        matrix = np.eye(count) / PRIOR_WIDTH**2
        gradient = (fit.q - self.first) / PRIOR_WIDTH**2
        for i, s in enumerate(fit.s):
            root, noise = self.batch.roots[i], self.batch.noise
            z, dz, _ = self.exact.window(k, self._start(i, s), self.batch.currents[i], root, by_q)
            error = ((z - self.batch.targets[i]) / noise).ravel()
            rows = (dz / noise[:, None]).reshape(len(error), -1)
            by_s, by_parameters = rows[:, :held], rows[:, held:]
            b, a = by_s.T @ by_parameters, by_s.T @ error + s
            eliminated[i] = np.linalg.solve(by_s.T @ by_s + np.eye(held), np.column_stack([b, a]))
            matrix += by_parameters.T @ by_parameters - b.T @ eliminated[i, :, :-1]
            gradient = gradient + by_parameters.T @ error - b.T @ eliminated[i, :, -1]
        return matrix, gradient, eliminated

    def _start(self, i: int, s: FloatArray) -> FloatArray:
        y = self.batch.starts[i].copy()
        y[: self.exact.held] += self.batch.roots[i] @ s
        return y


SUBSTEPS = 10
"""Integration steps per sample: 100 us, a 110th of a period of the 90 Hz mass-on-oil mode."""
TRUST_SCHEDULE = (30.0, 10.0, 3.0, 1.0, 1.0, 1.0)
"""Model error that the filter assumes, by round."""
ITERATIONS = 5
"""Largest number of iterations in a round."""
FINAL_TRUSTS = (0.03, 0.3, 3.0)
"""Trusts of the final choice: the one that predicts the validation runs best."""
DELAY_LEAST, DELAY_FACTOR = 5e-3, 2.0
"""Upper bound of a dead time: at least so many s, and so many times that of the bench file."""
QUANTILE = 1.96
"""Standard deviations from the middle of a 95 % interval to its end."""

Report = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class IdentifiedParameter:
    """A learned parameter."""

    name: str
    unit: str
    before: float
    """In the bench file."""
    value: float
    low: float
    """Lower end of the 95 % interval, as far as windows are independent and the model holds."""
    high: float
    informed: bool
    """Whether the recordings add to the prior."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """A learned bench."""

    bench: Bench
    parameters: list[IdentifiedParameter]
    noise: FloatArray
    """Noise of the readings, measured in the recordings, shape (5,)."""
    rmse: FloatArray
    """RMSE of 70-sample predictions of the validation runs against the readings, shape (5,)."""

    @property
    def quality(self) -> Quality:
        """Quality of the learned bench."""
        return Quality.of((self.rmse / self.noise).tolist())

    def with_quality(self) -> Bench:
        """Return the learned bench with its measured quality."""
        return replace(self.bench, learned={"bench": self.bench.digest, **self.quality.to_mapping()})


def _usual(name: str, **parameters: float) -> dict[str, Any]:
    return {"id": name, "parameters": parameters}


COMMON_EFFECTS: tuple[dict[str, Any], ...] = (
    _usual("spring_stiffness", ratio=1.0), _usual("supply_pressure", ratio=1.0), _usual("valve_gain", ratio=1.0),
    _usual("bulk_modulus", ratio=1.0), _usual("friction_viscous", coefficient=0.0),
    _usual("valve_lag", bandwidth=100.0, damping=0.8), _usual("friction_coulomb", force=10.0),
    _usual("friction_stribeck", breakaway_force=1.0, velocity=0.02), _usual("friction_presliding", stiffness=2e5),
    _usual("leakage_internal", coefficient=0.0),
    {**_usual("sensor_lag", bandwidth=30.0, damping=0.7), "sensor": "load_force"},
)  # fmt: skip
"""Effects that a bench is likely to have, at typical values: what is learned where a bench file names none."""


def add_common_effects(bench: Bench) -> Bench:
    """Return the bench with `COMMON_EFFECTS`, unless its file has effects of its own."""
    return bench if bench.terms else replace(bench, load_cell_bandwidth=None, effects=COMMON_EFFECTS)


def learn(bench: Bench, data: Data, *, count: int = 120, seed: int = 0, report: Report = lambda text: None) -> Result:
    """Return the bench with its effects' and closures' parameters fitted to `count` windows of the training runs.

    A bench file without effects gets `COMMON_EFFECTS`.

    Raises ValueError: the recordings have no room for windows.
    """
    bench = add_common_effects(bench)
    exact = Sensitivities(BenchModel(_with_longer_dead_times(bench), substeps=SUBSTEPS))
    coordinates = _coordinates(bench, exact.model)
    noise = estimate_noise(data.training)
    chosen = _windows(data.training, count, np.random.default_rng(seed))
    q, matrix = _fitted(exact, coordinates, data.training, chosen, noise, report)
    deviation = np.sqrt(np.diag(np.linalg.inv(matrix)))
    theta = coordinates.parameters(q)
    rmse, _ = best_prediction_rmse(exact, theta, noise, data.validation)
    return Result(
        bench=_with(bench, exact.model, theta), parameters=_identified(exact.model, coordinates, q, deviation),
        noise=noise, rmse=rmse,
    )  # fmt: skip


def _fitted(
    exact: Sensitivities, coordinates: Parametrization, runs: list[Run], chosen: list[Indices], noise: FloatArray,
    report: Report,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Parameters, as coordinates, of the round that predicts best, and the information matrix there."""
    weights, q = noise, coordinates.coordinates(coordinates.values)
    best, kept = np.inf, (q, np.eye(len(q)))
    for number, trust in enumerate(TRUST_SCHEDULE, 1):
        follower = StateEstimator(exact, coordinates.parameters(q), weights, trust)
        problem = LeastSquaresProblem(exact, coordinates, _batch(follower, runs, chosen, weights))
        fit = FitState(q=q, s=np.zeros((len(problem.batch.starts), exact.held)))
        for _ in range(ITERATIONS):
            if not problem.iterate(fit):
                break
        residual = problem.residual_rms(fit)
        q, weights = fit.q, np.maximum(noise, residual)
        report(f"round {number} of {len(TRUST_SCHEDULE)}: error over noise {np.round(residual / noise, 3)}")
        if (error := float(np.mean(np.log(residual / noise)))) < best:
            best, kept = error, (q, problem.normal_equations(fit)[0])
    return kept


def best_prediction_rmse(
    exact: Sensitivities, theta: FloatArray, noise: FloatArray, runs: list[Run]
) -> tuple[FloatArray, StateEstimator]:
    """Return the lowest RMSE of 70-sample predictions, shape (5,), over the filter's trusts, and that filter."""
    followers = [StateEstimator(exact, theta, noise, trust) for trust in FINAL_TRUSTS]
    found = [(_prediction_rmse(follower, runs), follower) for follower in followers]
    return min(found, key=lambda one: float(np.mean(np.log(one[0]))))


def _with_longer_dead_times(bench: Bench) -> Bench:
    """The bench with dead times as long as they may become: a model keeps as many past currents as that needs."""
    delays = sum(effect["id"] == valve.TransportDelay.id for effect in bench.effects)

    def lengthened(effect: Any) -> Any:
        if effect["id"] != valve.TransportDelay.id:
            return effect
        time = max(DELAY_FACTOR * float(effect["parameters"]["time"]), DELAY_LEAST)
        return {**effect, "parameters": {"time": min(time, catalogue.DELAY_MAX / delays, 0.03)}}

    return replace(bench, effects=tuple(lengthened(effect) for effect in bench.effects))


def _coordinates(bench: Bench, model: BenchModel) -> Parametrization:
    """All parameters of effects and closures but where tables begin and end."""
    values = [value for effect in bench.terms for value in catalogue.parse_entry(effect)[1]]
    first = len(model.parameters) - len(values)
    free = [
        i for i in range(first, len(model.parameters))
        if not (model.parameters[i].name.startswith("closure") and model.parameters[i].name.endswith((".low", ".high")))
    ]  # fmt: skip
    delays = max(sum(one.name == DEAD_TIME for one in model.parameters), 1)
    longest = max(model.structure.past - 2, 0) * SAMPLE_PERIOD / delays
    bounded = [replace(one, high=longest) if one.name == DEAD_TIME else one for one in model.parameters]
    return Parametrization(bounded, np.concatenate([model.values[:first], values]), np.array(free))


def _windows(runs: list[Run], count: int, generator: np.random.Generator) -> list[Indices]:
    """Start samples of windows in each run, in rising order, without overlap."""
    places = [
        (i, begin) for i, run in enumerate(runs)
        for begin in range(min(SETTLING_SAMPLES, len(run) // 4), len(run) - HORIZON - 1, HORIZON)
    ]  # fmt: skip
    if len(places) < 2:
        raise ValueError("the recordings have no room for predictions: record more")
    picked = generator.choice(len(places), min(count, len(places)), replace=False)
    return [np.sort([places[j][1] for j in picked if places[j][0] == i]).astype(np.int64) for i in range(len(runs))]


def _batch(follower: StateEstimator, runs: list[Run], chosen: list[Indices], weights: FloatArray) -> WindowBatch:
    starts = [follower.initial_states(run, samples) for run, samples in zip(runs, chosen, strict=True)]
    states, roots = map(np.concatenate, zip(*starts, strict=True))
    steps = np.arange(HORIZON)
    return WindowBatch(
        starts=states, roots=roots,
        currents=np.concatenate([run.u[at[:, None] + steps] for run, at in zip(runs, chosen, strict=True)]),
        targets=np.concatenate([run.readings[at[:, None] + steps + 1] for run, at in zip(runs, chosen, strict=True)]),
        noise=weights,
    )  # fmt: skip


def _prediction_rmse(follower: StateEstimator, runs: list[Run]) -> FloatArray:
    """RMSE of predictions from the filter's states against the readings, shape (5,)."""
    squares, windows = np.zeros(READINGS), 0
    for run in runs:
        states, readings = follower.states(run), run.readings
        for begin in range(min(SETTLING_SAMPLES, len(run) // 4), len(run) - HORIZON - 1, HORIZON // 2):
            z = follower.exact.model.rollout(follower.k, states[begin].copy(), run.u[begin : begin + HORIZON])
            squares += np.mean((z - readings[begin + 1 : begin + HORIZON + 1]) ** 2, axis=0)
            windows += 1
    return np.asarray(np.sqrt(squares / max(windows, 1)))


def _identified(
    model: BenchModel, coordinates: Parametrization, q: FloatArray, deviation: FloatArray
) -> list[IdentifiedParameter]:
    value, half = coordinates.free_parameters(q), QUANTILE * deviation
    low, high = coordinates.free_parameters(q - half), coordinates.free_parameters(q + half)
    return [
        IdentifiedParameter(
            name=model.parameters[index].name, unit=model.parameters[index].unit,
            before=float(coordinates.values[index]), value=float(value[i]), low=float(low[i]), high=float(high[i]),
            informed=bool(deviation[i] < 0.5 * PRIOR_WIDTH),
        )
        for i, index in enumerate(coordinates.free)
    ]  # fmt: skip


def _with(bench: Bench, model: BenchModel, theta: FloatArray) -> Bench:
    """The bench with these parameters in its effects and closures."""
    kinds = [catalogue.parse_entry(effect)[0] for effect in bench.terms]
    rest = iter(theta[len(theta) - sum(len(kind.parameters) for kind in kinds) :])
    terms = [
        {**effect, "parameters": {one.name: float(f"{next(rest):.9g}") for one in kind.parameters}}
        for effect, kind in zip(bench.terms, kinds, strict=True)
    ]
    effects, closures = terms[: len(bench.effects)], terms[len(bench.effects) :]
    without = [{key: value for key, value in one.items() if key != "id"} for one in closures]
    return replace(bench, effects=tuple(effects), closures=tuple(without))
