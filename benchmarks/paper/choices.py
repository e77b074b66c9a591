# SPDX-License-Identifier: Apache-2.0
"""The other choices of what the paper leaves open, and what came of them: without torch, for the page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.paper.store import Store

CHOICES: Mapping[str, Mapping[str, Any]] = {
    "batch-64": {"batch_size": 64},
    "batch-1024": {"batch_size": 1024},
    "entropy-1": {"target_entropy": -1.0},
    "entropy-4": {"target_entropy": -4.0},
    "reward-a-fifth": {"reward_scale": 0.004},
    "reward-fivefold": {"reward_scale": 0.1},
}
"""Settings that differ from ours: batch 256, target entropy -2, the reward's factor 0.02."""
NORMALISERS: Mapping[str, float | None] = {"observation-standardised": None, "observation-a-fifth": 5.0}
"""Factor on the observation's scales, which are the reach of normal runs; None: mean 0 and deviation 1 under the first
actor, as a running normaliser has it."""
VARIED = (*CHOICES, *NORMALISERS)
CHOSEN = "as chosen"


def scores(store: Store, name: str) -> list[tuple[float, float]]:
    """Of each seed that is there: best and last score of the training's examinations (RMSE over fixed gains')."""
    if name == CHOSEN:
        kept = [store.kept(f"II-paper-{seed}") for seed in range(store.size.seeds)]
        curves = [[float(row["score"]) for row in one["curve"][1:]] for one in kept if one is not None]
    else:
        kept = [store.kept(f"sensitivity-{name}-{seed}") for seed in range(store.size.seeds)]
        curves = [one["scores"] for one in kept if one is not None]
    return [(min(curve), curve[-1]) for curve in curves]
