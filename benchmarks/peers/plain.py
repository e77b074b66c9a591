# SPDX-License-Identifier: Apache-2.0
"""Parameter fitting, as most tools do it: the nominal structure, the bench file's numbers, forward simulation.

`scipy.optimize.least_squares` over 13 numbers of bench.yaml; 24 windows of 70 ms a recording from the recorded valve
current, the start states of every window eliminated by Gauss-Newton. A number is named if it moved by more than its
standard deviation allows (95 % over all 13, Bonferroni) and by more than 0.3 %.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.optimize import least_squares

from benchmarks.peers.run import Recordings, held_out
from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.simulation import Plant
from hydro_diagnosis.preprocessing.smoothing import smooth
from hydro_sim.model.bench import Bench
from hydro_sim.model.equations import LOAD_CELL_DAMPING, hydraulic_force
from hydro_sim.model.hydraulics import advance

LENGTH, WINDOWS, STEPS = 70, 24, 5
NAMES = {
    "bulk_modulus": "bulk_modulus",
    "piston_area": "piston_area",
    "area_ratio": "area_ratio",
    "supply_pressure": "supply_pressure",
    "tank_pressure": "tank_pressure",
    "valve_nominal_flow": "valve_gain",
    "dead_volume_a": "dead_volume",
    "dead_volume_b": "dead_volume",
    "moving_mass": "moving_mass",
    "viscous_friction": "friction_viscous",
    "spring_stiffness": "spring_stiffness",
    "spring_rest_position": "spring_rest",
    "load_cell_bandwidth": "sensor_lag",
}
"""Keys of bench.yaml, and the cause that a wrong one is."""
_UNIT = {"tank_pressure": 1e6, "spring_rest_position": 0.04}
"""SI units that a change of 1 stands for; of all others, the nominal value."""
_STATE = np.array([1e-6, 1e-4, 1e3, 1e3, 0.1, 10.0])[:, None]
"""Steps of x_p, x_p', p_a, p_b, the load cell's amplifier and its rate."""
_ORDER = np.array([2, 3, 0, 1, 4, 5])
"""Where those are in the state of `hydro_sim.model.hydraulics`."""
SIGNIFICANT, WORTH = 3.1, 0.003
CHANNELS = ("hydraulic_force", "load_force", "pressure_a", "pressure_b", "piston_position")


@dataclass(frozen=True)
class Windows:
    """Windows of all recordings side by side."""

    start: FloatArray
    """State at the start, shape (6, windows)."""
    current: FloatArray
    """A, shape (windows, samples)."""
    recorded: FloatArray
    """Shape (windows, samples, 5)."""


def solve(case: Recordings) -> tuple[dict[str, list[str]], float]:
    """Numbers that moved, and the held-out error over the noise floor."""
    windows = _windows(case.fitted)
    noise = np.array([case.noise[name] for name in CHANNELS])
    names = list(NAMES)
    low = np.full(len(names), -0.6)
    low[names.index("tank_pressure")] = 0.0
    found = least_squares(
        lambda change: _residual(_bench(change), windows, noise), np.full(len(names), 1e-6), bounds=(low, 1.0),
        diff_step=1e-4, x_scale=0.02, max_nfev=25, ftol=1e-6,
    )  # fmt: skip
    spread = 2.0 * found.cost / (len(found.fun) - len(names) - windows.start.size)
    deviation = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)) * max(spread, 1.0))
    moved = [NAMES[name] for name, change, one in zip(names, found.x, deviation, strict=True)
             if abs(change) > max(SIGNIFICANT * one, WORTH)]  # fmt: skip
    fitted = _bench(found.x)
    plants = [Plant.of(SegmentModel(model.segment, fitted), ()) for model in case.held]
    return {"bench.yaml": list(dict.fromkeys(moved))}, held_out(plants, case.noise)


def _bench(change: FloatArray) -> Bench:
    bench = Bench.nominal()
    return replace(bench, **{
        name: getattr(bench, name) + one * _UNIT.get(name, getattr(bench, name))
        for name, one in zip(NAMES, change, strict=True)
    })  # fmt: skip


def _windows(models: list[SegmentModel]) -> Windows:
    bench = Bench.nominal()
    start, current, recorded = [], [], []
    for model in models:
        p_a, p_b = smooth(model.channels["pressure_a"]), smooth(model.channels["pressure_b"])
        spring = bench.spring_stiffness * (model.channels["piston_position"] - bench.spring_rest_position)
        shown = model.memory.low_pass("plain", spring, bench.load_cell_bandwidth, LOAD_CELL_DAMPING)
        states = np.stack([model.x, model.v, p_a, p_b, shown, np.gradient(shown, model.step)])
        last = len(model.segment) - LENGTH - model.settle
        for at in np.linspace(model.settle, last, WINDOWS // max(len(models) // 3, 1)).astype(int):
            start.append(states[:, at])
            current.append(model.channels["valve_current"][at : at + LENGTH])
            recorded.append(np.column_stack([model.channels[name][at : at + LENGTH] for name in CHANNELS]))
    return Windows(np.array(start).T, np.array(current), np.array(recorded))


def _residual(bench: Bench, windows: Windows, noise: FloatArray) -> FloatArray:
    """Simulated minus recorded over the noise, with the start states that fit best, flat."""
    constants = bench.constants()[0]
    state = windows.start.copy()
    for _ in range(2):
        base = _apart(constants, state, windows, noise)
        moved = [_apart(constants, state + _STATE * (np.arange(6) == k)[:, None], windows, noise) for k in range(6)]
        slopes = np.stack([one - base for one in moved], axis=-1)
        normal = np.einsum("wij,wik->wjk", slopes, slopes) + 1e-9 * np.eye(6)
        force = np.einsum("wij,wi->wj", slopes, base)
        state = state - _STATE * np.linalg.solve(normal, force[..., None])[..., 0].T
    return np.nan_to_num(_apart(constants, state, windows, noise).ravel(), nan=1e3, posinf=1e3, neginf=-1e3)


def _apart(constants: np.void, state: FloatArray, windows: Windows, noise: FloatArray) -> FloatArray:
    first = np.empty((state.shape[1], 6))
    first[:, _ORDER] = state.T
    shown = _simulate(constants, first, windows.current)
    return np.clip((shown - windows.recorded) / noise, -1e4, 1e4).reshape(len(first), -1)


@njit(cache=True)
def _simulate(bench, first, current):
    """Readings of all windows, shape (windows, samples, 5)."""
    windows, samples = current.shape
    shown = np.empty((windows, samples, 5))
    for w in range(windows):
        y = first[w].copy()
        for k in range(samples):
            shown[w, k, 0] = hydraulic_force(bench, y[0], y[1])
            shown[w, k, 1] = y[4]
            shown[w, k, 2], shown[w, k, 3], shown[w, k, 4] = y[0], y[1], y[2]
            advance(bench, y, current[w, k], SAMPLE_PERIOD, STEPS)
    return shown
