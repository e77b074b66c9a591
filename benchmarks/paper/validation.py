# SPDX-License-Identifier: Apache-2.0
"""Table val_cont on the emulated bench: the paper's filters at 100 Hz and ours at 1 kHz, in the paper's cases.

Random gains are drawn every 10 ms. Shares count violations, M_c > 0: so the paper's 0.14 % for the stable controller
makes sense, which its text calls "verified". M_c of different metrics are different quantities: only its sign compares.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.paper import metric, models
from benchmarks.paper.store import CASES, FILTERS, Result, Store, truth
from hydro_core.signals import SAMPLE_PERIOD
from hydro_filter.validation import runs
from hydro_filter.validation.runs import Corrector, Trial, gammas
from hydro_filter.validation.runs import run as run_trial
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench


def run(store: Store, seed: int) -> None:
    """Every filter in every case; those that need no training first."""
    for chosen in FILTERS:
        for name in CASES:
            store.piece(f"validation-{name}-{chosen}-{seed}", partial(_run, store, name, chosen, seed))


def corrector(store: Store, chosen: str, seed: int) -> Corrector:
    """A filter of `FILTERS`; the paper's are those of this training seed."""
    if chosen in ("ours", "none"):
        return runs.make_filter("learned" if chosen == "ours" else "none")
    return metric.PaperFilter(
        metric.load(store, chosen.removeprefix("paper-"), seed), models.network(store, "squared", seed)
    )


def _run(store: Store, name: str, chosen: str, seed: int) -> Result:
    case, bench = runs.CASES[name], Bench.nominal()
    gains = case.draw_gains(seed, store.size.validation_seconds)
    trial = Trial(bench=bench, reference=case.reference, gains=gains, seed=seed)
    done = run_trial(trial, TruthPlant(truth(store.bench)), corrector(store, chosen, seed))
    settled = done.states[min(runs.SETTLING_SAMPLES, len(done.states) // 2) :]
    units = np.array([100.0, 100.0, 1.0, 100.0, 1.0])
    return {
        "bounded": done.bounded, "seconds": len(done.states) * SAMPLE_PERIOD,
        "rmse": runs.tracking_rmse(settled), "chatter": runs.chattering(settled),
        "gammas": (units * np.array(gammas(done.results, bench.valve_current_max))).tolist(),
    }  # fmt: skip
