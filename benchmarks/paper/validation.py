# SPDX-License-Identifier: Apache-2.0
"""Table val_cont on the emulated bench: the paper's filters at 100 Hz and ours at 1 kHz, in the paper's cases.

Random gains are drawn every 10 ms. Shares count violations, M_c > 0: so the paper's 0.14 % for the stable controller
makes sense, which its text calls "verified". M_c of different metrics are different quantities: only its sign compares.
"""

from __future__ import annotations

import numpy as np

from benchmarks.paper import metric
from benchmarks.paper.certificate import paper_filter
from benchmarks.paper.store import CASES, FILTERS, PRINTED, Result, Store
from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_filter.validation import cases, runs
from hydro_filter.validation.trial import Corrector, Run, Trial, gammas
from hydro_filter.validation.trial import run as run_trial
from hydro_sim.emulator.truth.config import profile
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench


def run(store: Store) -> None:
    """Every filter in every case."""
    for name in CASES:
        for chosen in FILTERS:
            store.piece(f"validation-{name}-{chosen}", lambda n=name, c=chosen: _cell(store, n, c))  # type: ignore[misc]


def corrector(store: Store, chosen: str, seed: int) -> Corrector:
    """A filter of `FILTERS`; the paper's are those of this training seed."""
    if chosen in ("ours", "none"):
        shipped = "learned" if chosen == "ours" else "none"
        return runs.make_filter(
            runs.Task(plant="emulator", case="stable", filter=shipped, seed=seed, seconds=1.0), Bench.nominal()
        )
    epochs = PRINTED["training_metric"]["epochs"] if chosen == "paper-short" else store.size.metric_epochs
    return paper_filter(metric.load(store, epochs, seed), metric.model_of(store, seed))


def _cell(store: Store, name: str, chosen: str) -> Result:
    case, plant, bench = cases.CASES[name], TruthPlant(profile("default")), Bench.nominal()
    done: list[Run] = []
    for seed in range(store.size.seeds):
        gains = case.draw(seed, store.size.validation_seconds)
        trial = Trial(bench=bench, reference=case.reference, gains=gains, seed=seed)
        done.append(run_trial(trial, plant, corrector(store, chosen, seed)))
    each = [gammas(one.results, bench.valve_current_max) for one in done]
    settled = [one.states[min(runs.SETTLING, len(one.states) // 2) :] for one in done]
    errors = [runs.tracking_error(states) for states in settled]
    units = np.array([100.0, 100.0, 1.0, 100.0, 1.0])
    return {
        "bounded": [one.bounded for one in done],
        "seconds": [len(one.states) * SAMPLE_PERIOD for one in done],
        "rmse": [float(np.sqrt(np.mean(error**2))) for error in errors],
        "chatter": [runs.chattering(states) for states in settled],
        "gammas": (units * np.array(each)).tolist(),
    }  # fmt: skip
