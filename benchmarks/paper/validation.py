# SPDX-License-Identifier: Apache-2.0
"""Table val_cont on the emulated bench: the paper's filters at 100 Hz and ours at 1 kHz, in the paper's cases.

Random gains are drawn every 10 ms. Shares count violations, M_c > 0: so the paper's 0.14 % for the stable controller
makes sense, which its text calls "verified". M_c of different metrics are different quantities: only its sign compares.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from math import nan
from typing import NamedTuple

import numpy as np

from benchmarks.paper import metric, models
from benchmarks.paper.store import CASES, FILTERS, Result, Store, truth
from hydro_core.signals import (
    SAMPLE_PERIOD,
    SAMPLES_PER_STEP,
    CorrectionStatus,
    FloatArray,
    ReferenceSignal,
    StateArray,
    Waveform,
)
from hydro_filter.controller.factory import FilterChoice
from hydro_filter.controller.loop_filter import LoopFilter, LoopFilterSettings
from hydro_filter.controller.loop_filter import Result as FilterResult
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench
from tests.filtered_run import Corrector, Trial
from tests.filtered_run import run as run_trial

SETTLING_SAMPLES = 2000
"""Samples left out of RMSE and chattering: the fade from rest."""
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)


@dataclass(frozen=True)
class Case:
    """Gains over time."""

    proportional: tuple[float, float]
    """Range of K_p [1/s]."""
    integral: tuple[float, float]
    """Range of K_i [1/s^2]."""
    hold_steps: int = 0
    """Policy steps of 10 ms for which drawn gains are held; 0: the whole run."""
    switched: bool = False
    """K_p is at either end of its range in turn, from a random phase on, instead of drawn."""

    def draw_gains(self, seed: int, seconds: float) -> FloatArray:
        """Return random gains of a run, shape (policy steps, 2)."""
        rng, steps = np.random.default_rng(seed), round(seconds / (SAMPLES_PER_STEP * SAMPLE_PERIOD))
        if self.switched:
            turns = (np.arange(steps) + int(rng.integers(2 * self.hold_steps))) // self.hold_steps % 2
            return np.column_stack([np.where(turns == 0, *self.proportional), np.full(steps, self.integral[0])])
        span = self.hold_steps or steps
        draws = -(-steps // span)
        pairs = np.column_stack([rng.uniform(*self.proportional, draws), rng.uniform(*self.integral, draws)])
        return np.repeat(pairs, span, axis=0)[:steps]


GAINS: dict[str, Case] = {
    "stable": Case((90.0, 90.0), (15.0, 15.0)),
    "base": Case((15.0, 15.0), (5.0, 5.0)),
    "unstable": Case((-40.0, 40.0), (-5.0, 5.0), hold_steps=1),
    "unstable-slow": Case((-40.0, 40.0), (-5.0, 5.0), hold_steps=50),
    "negative": Case((-40.0, 0.0), (-5.0, 0.0), hold_steps=1),
    "positive": Case((0.0, 40.0), (0.0, 5.0), hold_steps=1),
    "high": Case((100.0, 300.0), (5.0, 15.0)),
    "wide": Case((-40.0, 300.0), (-5.0, 15.0), hold_steps=1),
    "wide-slow": Case((-40.0, 300.0), (-5.0, 15.0), hold_steps=50),
    "switched": Case((15.0, 300.0), (15.0, 15.0), hold_steps=1, switched=True),
    "switched-slow": Case((15.0, 300.0), (15.0, 15.0), hold_steps=50, switched=True),
}
"""The paper's cases (stable, unstable) and more, by name."""


class Gammas(NamedTuple):
    """The paper's Table val_cont, with each share named after the samples it counts (physics.md, decisions)."""

    correction: float
    """gamma_1: mean |delta_u| over u_max."""
    violated_before: float
    """gamma_2: share of samples with M_c > 0 without the correction."""
    mean_before: float
    """gamma_3: mean M_c [1/s] without it."""
    violated_after: float
    """gamma_4: share with M_c > 0 under it."""
    mean_after: float
    """gamma_5: mean M_c [1/s] under it."""


def gammas(results: list[FilterResult], current_max: float) -> Gammas:
    """Return gamma_1 to gamma_5 over all evaluated samples; M_c up to 1e-6/s counts as satisfied."""
    skipped = (CorrectionStatus.NAN, CorrectionStatus.STALE, CorrectionStatus.MISMATCH)
    table = np.array([result[:3] for result in results if result.status not in skipped] or [(nan, nan, nan)])
    correction, before, after = np.abs(table[:, 0]) / current_max, table[:, 1], table[:, 2]
    shares = (before > 1e-6).mean(), (after > 1e-6).mean()
    return Gammas(
        float(correction.mean()), float(shares[0]), float(before.mean()), float(shares[1]), float(after.mean())
    )


def run(store: Store, seed: int) -> None:
    """Every filter in every case; those that need no training first."""
    for chosen in FILTERS:
        for name in CASES:
            store.piece(f"validation-{name}-{chosen}-{seed}", partial(_run, store, name, chosen, seed))


def corrector(store: Store, chosen: str, seed: int) -> Corrector:
    """A filter of `FILTERS`; the paper's are those of this training seed."""
    if chosen in ("ours", "none"):
        return _ours(chosen == "none")
    return metric.PaperFilter(
        metric.load(store, chosen.removeprefix("paper-"), seed), models.network(store, "squared", seed)
    )


@cache
def _ours(bypass: bool) -> LoopFilter:
    return FilterChoice(bench=Bench.nominal()).make(LoopFilterSettings(bypass=bypass))


def _run(store: Store, name: str, chosen: str, seed: int) -> Result:
    case, bench = GAINS[name], Bench.nominal()
    gains = case.draw_gains(seed, store.size.validation_seconds)
    trial = Trial(bench=bench, reference=SINE, gains=gains, seed=seed)
    done = run_trial(trial, TruthPlant(truth(store.bench)), corrector(store, chosen, seed))
    settled = done.states[min(SETTLING_SAMPLES, len(done.states) // 2) :]
    units = np.array([100.0, 100.0, 1.0, 100.0, 1.0])
    return {
        "bounded": done.bounded, "seconds": len(done.states) * SAMPLE_PERIOD,
        "rmse": tracking_rmse(settled), "chatter": chattering(settled),
        "gammas": (units * np.array(gammas(done.results, bench.valve_current_max))).tolist(),
    }  # fmt: skip


def tracking_rmse(states: StateArray) -> float:
    """Return the RMSE of f_r - f_l [N]."""
    return float(np.sqrt(np.mean((states["reference_force"] - states["load_force"]) ** 2)))


def chattering(states: StateArray) -> float:
    """Return the RMS [A/s] of the valve current's rate."""
    return float(np.sqrt(np.mean((np.diff(states["valve_current"]) / SAMPLE_PERIOD) ** 2))) if len(states) > 1 else 0.0
