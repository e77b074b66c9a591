# SPDX-License-Identifier: Apache-2.0
"""Held-out validation: the corrected model is simulated on recordings to which no parameter was fitted.

Windows of 70 ms are simulated from the recorded valve current. Their four initial states are estimated from the
window itself (multiple shooting): an estimate from the samples before would be coarser than an encoder's step. The free
run, half a second, starts from the recording's smoothed state and is not corrected again. Windows that the model itself
cannot predict are listed and excluded from the error that counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.effects.base import CHANNELS, MOTION, EffectHypothesis, FloatArray, claims_key
from hydro_diagnosis.model.simulation import WindowSimulation, WindowStarts
from hydro_diagnosis.preprocessing.smoothing import POSITION_NOISE_GAIN, TOTAL_NOISE_GAIN, VELOCITY_NOISE_GAIN
from hydro_diagnosis.recording import CHANNEL_UNITS
from hydro_diagnosis.significance import COVERAGE_FACTOR, ITERATIONS, OUTLIER_FACTOR

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Problem
    from hydro_diagnosis.model.segment_model import SegmentModel

MAX_LEFT_OUT_SHARE = 0.25
"""Largest share of the windows that may be left out; if more are unpredictable, the errors are over all windows."""
HORIZON_TIME = 0.07
"""Length of a window [s]."""
FREE_RUN_TIME = 0.5
"""Length of the free run [s]."""
_PRESSURE_OFFSETS = tuple(6.25e-5 * sign * one for one in (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0) for sign in (1.0, -1.0))[
    1:
]
"""Offsets of the initial pressure in chamber A, over the supply's, that are tried."""
_START_UNCERTAINTY = np.array([6.25e-5, 0.0625, 3.125e-3, 3.125e-3])
"""Uncertainty of the recording's smoothed state: position over the stroke, velocity in strokes a second, pressures over
the supply's."""


@dataclass(frozen=True)
class Comparison:
    """Errors of two claim sets over the same windows."""

    channels: dict[str, dict[str, Any]]
    """Root mean square errors of each channel, by the keys of `_channel`."""
    windows: int
    left_out: list[dict[str, Any]]
    """Windows that are unpredictable under the second claim set: not in `rmse_before` and `rmse_after`.

    Each by its `recording`, and `start` in s since the recording's.
    """


SimulatedWindows = tuple[FloatArray, dict[str, FloatArray]]
"""Initial states of windows, shape (4, windows), and reading minus recording by channel, shape (rows, windows)."""
SimulationCache = dict[tuple[Any, ...], SimulatedWindows]
"""Cache of simulations, by segment, horizon, kind of start and claims."""


@dataclass(frozen=True)
class _Windows:
    """Windows of one segment under claims."""

    simulation: WindowSimulation
    begins: WindowStarts
    """First sample of each, shape (windows,)."""
    length: int
    """Samples of each."""
    noise: dict[str, float]
    """Noise floors by channel."""

    @property
    def _uncertainty(self) -> FloatArray:
        """Uncertainty of the recording's smoothed state, SI units, shape (4,)."""
        size = self.simulation.model.base.size
        return _START_UNCERTAINTY * np.array([size.length, size.length, size.pressure, size.pressure])

    def apart(self, starts: FloatArray) -> dict[str, FloatArray]:
        """Reading minus recording by channel, from starts of all windows, several times over: shape (4, lanes)."""
        model = self.simulation.model
        lanes = np.tile(self.begins, starts.shape[1] // len(self.begins))
        at = lanes[None, :] + np.arange(0, self.length, model.spacing)[:, None]
        shown = self.simulation.readings(starts, self.begins, self.length)
        return {name: one[:: model.spacing] - model.channels[name][at] for name, one in shown.items()}

    def unpredictable(self, state: FloatArray, apart: dict[str, FloatArray]) -> npt.NDArray[np.bool_]:
        """Return whether the uncertainty of its start explains each window's error, shape (windows,).

        It does if the outcomes of starts drawn within the sensors' noise at one instant scatter by half of the error.
        `state`: the start of each window, shape (4, windows); `apart`: reading minus recording from there, by channel.
        """
        error = self._size(apart)
        if not np.any(error > COVERAGE_FACTOR):
            return np.zeros(len(self.begins), dtype=bool)
        model = self.simulation.model
        position, step = self.noise.get("piston_position", 0.0), model.step * model.spacing
        pressures = (TOTAL_NOISE_GAIN * self.noise.get("pressure_" + chamber, 0.0) for chamber in "ab")
        at_one_instant = [POSITION_NOISE_GAIN * position, VELOCITY_NOISE_GAIN * position / step, *pressures]
        draws, windows = 8, len(self.begins)
        moved = np.random.default_rng(0).standard_normal((draws, *state.shape)) * np.array(at_one_instant)[:, None]
        starts = np.concatenate([state[None], state + moved]).transpose(1, 0, 2).reshape(4, -1)
        shown = self.simulation.readings(starts, self.begins, self.length)
        each = {name: one.reshape(self.length, draws + 1, windows) for name, one in shown.items()}
        scatter = self._size({name: (one[:, 1:] - one[:, :1]).reshape(-1, windows) for name, one in each.items()})
        enough = np.maximum(0.5 * error, OUTLIER_FACTOR * np.nanmedian(scatter))
        return np.asarray((error > COVERAGE_FACTOR) & (scatter >= enough))

    def _size(self, apart: dict[str, FloatArray]) -> FloatArray:
        """Root mean square per window over time and channels, in noise floors, shape (windows,)."""
        noise = self.noise
        squares = [np.mean(np.square(one / noise[name]), axis=0) for name, one in apart.items() if noise.get(name, 0.0)]
        return np.asarray(np.sqrt(np.mean(squares, axis=0)))

    def shot(self, recorded: FloatArray) -> FloatArray:
        """Initial states by least squares per window, regularised by the recording's smoothed state and uncertainty.

        Where the piston sticks, the time of break-away depends on tenths of a newton, and the cost is not smooth: so
        several pressures are tried first, a step that increases the cost is halved, and the best state is returned.
        """
        state = recorded
        if self.simulation.has_stiction:
            supply = self.simulation.model.base.size.pressure
            tries = [state + np.array([[0.0], [0.0], [supply * part], [0.0]]) for part in _PRESSURE_OFFSETS]
            costs = np.sum(np.square(self._misses(np.concatenate(tries, axis=1), recorded)), axis=0)
            first = np.argmin(np.where(np.isfinite(costs), costs, np.inf), axis=0)
            state = np.stack(tries)[first, :, np.arange(len(self.begins))].T
        scale = self._uncertainty / 50.0  # steps of the finite differences
        best, cost = state.copy(), np.full(len(self.begins), np.inf)
        for _ in range(ITERATIONS):
            moved = [state] + [state + scale[:, None] * (np.arange(4) == j)[:, None] for j in range(4)]
            misses = self._misses(np.concatenate(moved, axis=1), recorded)
            reached = np.sum(np.square(misses[:, 0]), axis=0)
            gained = reached < cost
            if not np.any(reached < 0.995 * cost):
                break
            best[:, gained], cost[gained] = state[:, gained], reached[gained]
            state = 0.5 * (state + best)
            for w in np.flatnonzero(gained):
                slopes = misses[:, 1:, w] - misses[:, :1, w]
                if np.all(np.isfinite(slopes)):
                    state[:, w] -= scale * np.linalg.lstsq(slopes, misses[:, 0, w], rcond=1e-10)[0]
        reached = np.sum(np.square(self._misses(state, recorded)[:, 0]), axis=0)
        return np.where(reached < cost, state, best)

    def _misses(self, states: FloatArray, recorded: FloatArray) -> FloatArray:
        """Errors of readings and initial state, over their uncertainties, shape (n, variants, windows)."""
        apart = self.apart(states)
        parts = [apart[name] / self.noise[name] for name in apart if self.noise.get(name, 0.0) > 0.0]
        variants = states.shape[1] // len(self.begins)
        parts.append((states - np.tile(recorded, variants)) / self._uncertainty[:, None])
        stacked = np.concatenate(parts)
        return stacked.reshape(len(stacked), variants, len(self.begins))


def compare(
    models: Sequence[SegmentModel], before: Sequence[EffectHypothesis], after: Sequence[EffectHypothesis],
    noise: dict[str, float], *,
    seconds: float, windows: int, shooting: bool, cache: SimulationCache | None = None,
) -> Comparison:  # fmt: skip
    """Return the errors of two claim sets over the same windows of held-out recordings; `cache`: extended."""
    seen: list[_Seen] = []
    cache = {} if cache is None else cache
    each = max(windows // len(models), 1)
    for number, model in enumerate(models):
        length = round(seconds / model.step)
        if len(model.segment) < model.settle + length + 50:
            continue
        begins = np.linspace(model.settle, len(model.segment) - length - 20, each).astype(np.int64)
        begins = np.unique(begins - (begins - model.segment.phase) % model.spacing)
        with np.errstate(all="ignore"):
            found: list[SimulatedWindows] = []
            for claims in (before, after):
                stretch = _Windows(WindowSimulation(model, claims), begins, length, noise)
                key = (number, seconds, shooting, *claims_key(claims))
                if key not in cache:
                    state = stretch.simulation.recorded[:, begins]
                    state = stretch.shot(state) if shooting else state
                    cache[key] = state, stretch.apart(state)
                found.append(cache[key])
            (_, old), (state, new) = found
            none = np.zeros(len(begins), dtype=bool)
            left_out = stretch.unpredictable(state, new) if shooting else none
        seen.append(_Seen(model, begins, old, new, left_out))
    count, out = sum(len(one.begins) for one in seen), sum(int(np.sum(one.left_out)) for one in seen)
    if out > MAX_LEFT_OUT_SHARE * count:
        seen = [replace(one, left_out=np.zeros_like(one.left_out)) for one in seen]
    names = dict.fromkeys(name for one in seen for name in one.before)
    channels = {name: _channel(name, [one for one in seen if name in one.before], noise) for name in names}
    open_: list[dict[str, Any]] = []
    for one in seen:
        segment = one.model.segment
        starts = segment.start + segment.step * one.begins[one.left_out]
        open_ += [{"recording": segment.recording, "start": round(float(start), 6)} for start in starts]
    return Comparison(channels, count, open_)


@dataclass(frozen=True)
class _Seen:
    """Windows of a segment, and reading minus recording in them by channel, shape (recorded rows, windows)."""

    model: SegmentModel
    begins: WindowStarts
    before: dict[str, FloatArray]
    after: dict[str, FloatArray]
    left_out: npt.NDArray[np.bool_]


def _channel(name: str, seen: Sequence[_Seen], noise: dict[str, float]) -> dict[str, Any]:
    """Root mean square errors in the channel's unit, over the windows that can be predicted, and over `all`."""
    before, after = [one.before[name] for one in seen], [one.after[name] for one in seen]
    kept = [~one.left_out for one in seen]
    return {
        "unit": CHANNEL_UNITS[name],
        "rmse_before": _rms([part[:, keep] for part, keep in zip(before, kept, strict=True)]),
        "rmse_after": _rms([part[:, keep] for part, keep in zip(after, kept, strict=True)]),
        "noise_floor": noise.get(name, 0.0),
        "rmse_before_all": _rms(before),
        "rmse_after_all": _rms(after),
    }


def _rms(parts: list[FloatArray]) -> float:
    with np.errstate(over="ignore"):  # a model that runs away
        mean = float(np.mean(np.square(np.concatenate([part.ravel() for part in parts]))))
    return float(np.sqrt(mean)) if np.isfinite(mean) else float("inf")


SIMULATION_CHANNELS = {"valve_current", "piston_position", "pressure_a", "pressure_b"}
"""Channels that a forward simulation requires."""
_FORCE_CHANNELS = {"motion": "hydraulic_force", "load": "load_force", "hydraulic": "hydraulic_force"}
_EQUATION_UNITS = {"pressure_a": "Pa", "pressure_b": "Pa", "motion": "N", "load": "N", "hydraulic": "N"}


def holdout_errors(
    problem: Problem,
    holdout: Problem,
    claims: Sequence[EffectHypothesis],
    cache: SimulationCache | None = None,
) -> dict[str, Any]:
    """Return the errors of the baseline and of the corrected model, as under `fit` in report.json.

    `holdout`: held-out recordings; noise and baseline are those of `problem`. `cache`: simulations so far, which it
    extends.
    """
    models = holdout.models
    equations = equation_errors(holdout, claims)
    rod = any(model.load_cell_at_rod for model in models)
    if rod or not all(model.channels.keys() >= SIMULATION_CHANNELS for model in models) or MOTION not in problem.blocks:
        needed = "a law of the load" if rod else "current, position and both pressures, and the moving mass"
        why = f"a forward simulation needs {needed}"
        return {"holdout": {}, "horizon_s": HORIZON_TIME, "free_run": {}, "why": why, "equations": equations}
    before, after, noise = problem.baseline, (*problem.baseline, *claims), problem.sensor_noise
    horizon = compare(models, before, after, noise, seconds=HORIZON_TIME, windows=48, shooting=True, cache=cache)
    left_out = horizon.left_out
    why = (
        f"{len(left_out)} of {horizon.windows} held-out windows, in which the piston sticks or breaks loose, cannot be "
        "predicted: they are left out of the errors over 70 ms."
        if left_out
        else ""
    )
    free = compare(models, before, after, noise, seconds=FREE_RUN_TIME, windows=6, shooting=False, cache=cache)
    return {
        "holdout": horizon.channels,
        "horizon_s": HORIZON_TIME,
        "unpredictable": {"windows": horizon.windows, "count": len(left_out), "left_out": left_out, "why": why},
        "free_run": {"seconds": FREE_RUN_TIME, **free.channels},
        "equations": equations,
    }


def worse_channels(report: Mapping[str, Any], before: Mapping[str, Any] | None = None) -> list[str]:
    """Return the channels whose held-out error is a fifth larger than before, and than the noise.

    `report`: as of `holdout_errors`; where there is no simulation, its equations count. `before`: the same without some
    of the claims: the smaller of its errors and the bench file's counts; absent: the bench file's.
    """
    errors, known = (one["holdout"] or one["equations"] if one else {} for one in (report, before))
    worse = []
    for name, one in errors.items():
        least = min(one["rmse_before"], known[name]["rmse_after"] if name in known else np.inf)
        if not one["rmse_after"] <= 1.2 * max(least, one["noise_floor"]):
            worse.append(name)
    return worse


def equation_errors(problem: Problem, claims: Sequence[EffectHypothesis]) -> dict[str, dict[str, Any]]:
    """Return the errors on the recordings of `problem`, by channel, before and after the claims are added.

    As under `fit.equations` in report.json; `signal`: root mean square of the equation's measured signal.

    Residuals are weighted by their inverse variances, as in the fit: where dry friction reverses its sign is uncertain,
    and would dominate every figure. `before` and `after` have the same weights.
    """
    before, after = problem.residual(()), problem.residual(claims)
    found = {}
    for name in (CHANNELS[index] for index in np.unique(problem.layout.channel)):
        measured = _FORCE_CHANNELS.get(name, name)
        parts = [model.smooth(model.channels[measured]) for model in problem.models if measured in model.channels]
        found[name] = {
            "unit": _EQUATION_UNITS[name],
            "rmse_before": _weighted(problem, name, before),
            "rmse_after": _weighted(problem, name, after),
            "noise_floor": problem.noise[name],
            "signal": float(np.sqrt(np.mean(np.square(np.concatenate(parts))))) if parts else float("nan"),
        }
    return found


def _weighted(problem: Problem, name: str, residual: FloatArray) -> float:
    """Root of the weighted mean square of a channel's residuals, physical unit; `residual` is over its deviations."""
    layout = problem.layout
    squares = weights = 0.0
    for k in range(len(problem.models)):
        own = (layout.channel == CHANNELS.index(name)) & (layout.segment == k)
        squares += float(np.sum(np.square(residual[own])))
        weights += float(np.sum(np.square(1.0 / problem.deviations[own])))
    return float(np.sqrt(squares / weights))
