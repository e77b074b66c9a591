# SPDX-License-Identifier: Apache-2.0
"""What the pieces cost: CPU of those that were run, and what a whole run comes to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.paper.choices import VARIED
from benchmarks.paper.store import AUTHORITIES, CASES, FILTERS, PRINTED, Size, Store
from hydro_policy.evaluation.policy_examination import LEAD

EXAMINED = 33.0
"""s of bench time of an examination, two runs of four sines."""


@dataclass(frozen=True)
class Kind:
    """Pieces of one sort."""

    name: str
    pieces: tuple[str, ...]
    """`{}`: the seed."""
    work: Callable[[Size], float] = lambda size: 1.0
    """What a piece's time goes with, from one size to another."""

    def names(self, size: Size) -> list[str]:
        """Of all pieces of a size."""
        return [name.format(seed) for name in self.pieces for seed in range(size.seeds if "{}" in name else 1)]


def _on_the_bench(size: Size) -> float:
    """s of bench time of a training of I, with its examinations and the two evaluations after it."""
    exams = 1 + min(size.bench_episodes, 8)  # in the first one the fixed gains, too, each after its lead
    examined = (exams + 1) * EXAMINED + 2.0 * LEAD
    return size.bench_episodes * PRINTED["training_agent"]["steps"] / 100.0 + examined + 2.0 * EXAMINED


BENCHES = ("default", "outside")
KINDS = (
    Kind("networks, 70 samples", ("model-squared-{}", "model-printed-{}"), lambda size: size.model_epochs),
    Kind("networks, one step", ("model-one-step-{}",), lambda size: size.model_epochs),
    Kind("other models", ("model-analytic", "model-ours")),
    Kind("metrics, 3 epochs", ("metric-short-{}",), lambda size: size.rollouts),
    Kind("metric of the shipped filter", ("metric-ours",)),
    Kind("metrics, long", ("metric-long-{}",), lambda size: size.rollouts * size.metric_epochs),
    Kind(
        "runs of Table val_cont",
        tuple(f"validation-{case}-{chosen}-{{}}" for case in CASES for chosen in FILTERS),
        lambda size: size.validation_seconds,
    ),
    Kind("II, training", tuple(f"II-{one}-{{}}" for one in AUTHORITIES), lambda size: size.simulated_episodes),
    Kind(
        "II and III, evaluation",
        (
            *(f"rmse-{bench}-III-{{}}" for bench in BENCHES),
            *(f"rmse-{bench}-{one}-II-{{}}" for bench in BENCHES for one in AUTHORITIES),
        ),
    ),
    Kind("I", tuple(f"rmse-{bench}-{one}-I-{{}}" for bench in BENCHES for one in AUTHORITIES), _on_the_bench),
    Kind("chattering", tuple(f"chatter-{chosen}-{{}}" for chosen in ("none", "paper-short", "ours"))),
    Kind("sensitivity", tuple(f"sensitivity-{one}-{{}}" for one in VARIED), lambda size: size.simulated_episodes),
)


def spent(store: Store, kind: Kind) -> list[float]:
    """s of CPU of each piece that is there."""
    found = (store.kept(name) for name in kind.names(store.size))
    return [float(one["cpu"]) for one in found if one is not None]


def whole(store: Store, smaller: Store) -> float | None:
    """h of CPU of all pieces: as measured, else as those of a smaller size were, scaled by the work; None: neither."""
    total = 0.0
    for kind in KINDS:
        own, other = spent(store, kind), spent(smaller, kind)
        if not own and not other:
            return None
        each = np.mean(own) if own else np.mean(other) * kind.work(store.size) / kind.work(smaller.size)
        total += float(each) * len(kind.names(store.size))
    return total / 3600.0


def rows(*stores: Store) -> list[list[str]]:
    """For each kind and size: pieces there, of how many, s of CPU of one."""
    made = []
    for kind in KINDS:
        row = [kind.name]
        for store in stores:
            found = spent(store, kind)
            row += [f"{len(found)} of {len(kind.names(store.size))}", f"{np.mean(found):.1f}" if found else ""]
        made.append(row)
    return made
