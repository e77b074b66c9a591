# SPDX-License-Identifier: Apache-2.0
"""Sentences of `reasons` about what is learned from data: the models, and the metric."""

from __future__ import annotations

import numpy as np

from benchmarks.paper.store import PRINTED, Store
from benchmarks.paper.verdicts import numbers, pieces, table

LOAD_FORCE = 2
LABELS = ("stable", "unstable")


def analytic_is_near(store: Store) -> str:
    """The truth is made of the analytic model's equations."""
    found, printed = table(store, "model-analytic", "over_range"), PRINTED["rmse_model"]["analytic"][LOAD_FORCE]
    if not len(found) or found[0, LOAD_FORCE] > 0.1 * printed:
        return ""
    return (
        "The emulated bench is built on the analytic model's equations, which therefore err by "
        f"{100 * found[0, LOAD_FORCE]:.1f} % of f_l's range, not by {100 * printed:.0f} % as on the paper's bench."
    )


def network_error(store: Store) -> str:
    """What the network comes to beside it."""
    network, other = table(store, "model-squared-{}", "over_range"), table(store, "model-analytic", "over_range")
    if not len(network) or not len(other):
        return ""
    ratio = np.exp(np.log(network.mean(0) / other[0]).mean())
    epochs = table(store, "model-squared-{}", "best_epoch")
    share = 100.0 * network[:, LOAD_FORCE].mean()
    return (
        f"The network errs {ratio:.2g} times as much as they do (geometric mean of the states) and by "
        f"{share:.2f} % of f_l's range, best after {epochs.mean():.0f} epochs of two batches."
    )


def ours_is_identified(store: Store) -> str:
    """Ours against the analytic model."""
    own, other = table(store, "model-ours", "over_range"), table(store, "model-analytic", "over_range")
    if not len(own) or not len(other):
        return ""
    ratios = other[0] / own[0]
    return (
        f"Between {ratios.min():.0f} and {ratios.max():.0f} times less: its constants are identified on the bench's "
        "own recordings, spool and friction included, and its start states come from an observer."
    )


def horizon_ratio(store: Store) -> str:
    """70 samples against one."""
    found = pieces(store, "model-squared-{}", "model-one-step-{}")
    if not found:
        return ""
    ratios = np.mean([numbers(long["over_range"]) / numbers(short["over_range"]) for long, short in found], axis=0)
    few = " This is after 100 gradient steps, no whole training." if store.size.model_epochs <= 50 else ""
    return f"Its errors are {ratios.min():.2f} to {ratios.max():.2f} of those of one-step training, by state.{few}"


def three_epochs(store: Store) -> str:
    """Loss and shares after three epochs and after all, of one training."""
    histories = [found["history"] for (found,) in pieces(store, "metric-long-{}")]
    if not histories:
        return ""

    def mean(epoch: int, key: str) -> float:
        return float(np.mean(np.array([history[epoch][key] for history in histories], float)))

    def shares(epoch: int) -> str:
        stable, unstable = (100.0 * mean(epoch, key) for key in ("stable_verified", "unstable_found"))
        caught = "" if np.isnan(unstable) else f" and {unstable:.0f} % of the unstable"
        return f"{stable:.0f} % of the stable{caught}"

    longest = max(len(history) - 1 for history in histories)
    return (
        f"Held out, the loss is {mean(0, 'loss'):.3g} before training, {mean(3, 'loss'):.3g} after three epochs and "
        f"{mean(-1, 'loss'):.3g} after {longest} at most; the sign of M_c is right in {shares(3)} samples "
        f"after three, in {shares(-1)} after all."
    )


def hardly_unstable(store: Store) -> str:
    """A network that is not trained to the end does not show what gains do."""
    stable, unstable = (
        sum(found["rollouts"][name] for (found,) in pieces(store, "metric-short-{}")) for name in LABELS
    )
    if unstable >= 0.2 * stable:
        return ""
    return (
        f"Of the metric's rollouts {unstable} were unstable and {stable} stable, though a quarter has K_p below 0: the "
        f"network model is not the bench after {store.size.model_epochs} epochs."
    )
