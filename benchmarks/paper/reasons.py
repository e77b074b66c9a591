# SPDX-License-Identifier: Apache-2.0
"""Why a claim came out as it did: sentences whose figures are the pieces', each said only where those bear it out.

A sentence is a function of the pieces; it is empty where they are not there or say something else. So no reason
outlives the figures that it was written for; where none is left the page says so (`MISSING`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.paper.store import PRINTED, Store
from benchmarks.paper.verdicts import numbers, pieces
from hydro_bridge.signals import FloatArray

MISSING = "reason not written yet for these figures"
LOAD_FORCE = 2
Sentence = Callable[[Store], str]


def why(key: str, store: Store) -> str:
    """All sentences that hold for a claim at a size; `MISSING`: none does."""
    return " ".join(said for sentence in REASONS[key] if (said := sentence(store))) or MISSING


def table(store: Store, name: str, key: str) -> FloatArray:
    """A number or numbers of a piece, a row for each seed that is there, shape (seeds, n)."""
    return np.array([numbers(found[key]) for (found,) in pieces(store, name)])


def analytic_is_near(store: Store) -> str:
    """The truth is made of the analytic model's equations."""
    found, printed = table(store, "model-analytic", "over_range"), PRINTED["rmse_model"]["analytic"][LOAD_FORCE]
    if not len(found) or found[0, LOAD_FORCE] > 0.1 * printed:
        return ""
    return (
        "The emulated bench is built on the analytic model's equations, which therefore err by "
        f"{found[0, LOAD_FORCE]:.1%} of f_l's range, not by {printed:.0%} as on the paper's bench."
    )


def network_error(store: Store) -> str:
    """What the network comes to beside it."""
    network, other = table(store, "model-squared-{}", "over_range"), table(store, "model-analytic", "over_range")
    if not len(network) or not len(other):
        return ""
    ratio = np.exp(np.log(network.mean(0) / other[0]).mean())
    epochs = table(store, "model-squared-{}", "best_epoch")
    return (
        f"The network errs {ratio:.2g} times as much as they do (geometric mean of the states) and by "
        f"{network[:, LOAD_FORCE].mean():.2%} of f_l's range, best after {epochs.mean():.0f} epochs of two batches."
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
    """Loss and shares after three epochs and after all."""
    histories = [found["history"] for (found,) in pieces(store, "metric-{}")]
    if not histories:
        return ""

    def mean(epoch: int, key: str) -> float:
        return float(np.mean(np.array([history[epoch][key] for history in histories], float)))

    def shares(epoch: int) -> str:
        return f"{mean(epoch, 'stable_verified'):.0%} and {mean(epoch, 'unstable_found'):.0%}"

    labels = [
        sum(found["rollouts"][name] for (found,) in pieces(store, "metric-{}")) for name in ("stable", "unstable")
    ]
    return (
        f"Of the rollouts that it was trained and judged on {labels[0]} were stable and {labels[1]} unstable. "
        f"Held out, the loss is {mean(0, 'loss'):.3g} before training, {mean(3, 'loss'):.3g} after three epochs and "
        f"{mean(-1, 'loss'):.3g} after {store.size.metric_epochs}; the sign of M_c is right in {shares(3)} of the "
        f"stable and unstable samples after three, in {shares(-1)} after all."
    )


def corrections(case: str) -> Sentence:
    """How much the paper's filter corrects and how often its certificate is violated, before and after."""

    def say(store: Store) -> str:
        found = table(store, f"validation-{case}-paper-short-{{}}", "gammas")
        if not len(found):
            return ""
        size, before, _, after, _ = found.mean(0)
        told = f"It corrects by {size:.2g} % of the largest current; M_c > 0 in {before:.0f} % of the samples"
        return f"{told} before and {after:.0f} % after."

    return say


def stopped(case: str, *filters: str) -> Sentence:
    """How many runs tripped, and after how long."""

    def say(store: Store) -> str:
        told = []
        for chosen in filters:
            found = [one for (one,) in pieces(store, f"validation-{case}-{chosen}-{{}}")]
            ends = [one["seconds"] for one in found if not one["bounded"]]
            name = {"none": "without a filter", "ours": "behind ours"}.get(chosen, "behind the paper's")
            if ends:
                told.append(f"{name} {len(ends)} of {len(found)} trip, after {np.mean(ends):.1f} s")
            elif found:
                told.append(f"{name} none of {len(found)} trips in {store.size.validation_seconds:g} s")
        return _sentence(told)

    return say


def handed_back(bench: str) -> Sentence:
    """Whether I is the policy that came, and what its last one was worth."""

    def say(store: Store) -> str:
        found = pieces(store, f"rmse-{bench}-paper-I-{{}}", f"rmse-{bench}-paper-II-{{}}")
        if not found:
            return ""
        same = sum(first["rmse"] == second["rmse"] for first, second in found)
        chosen, last = (np.mean([_relative(a[key], b["rmse"]) for a, b in found]) for key in ("rmse", "last"))
        told = (
            f"RMSE after {store.size.bench_episodes} episodes, to II's: I {chosen:+.0%}, its last policy {last:+.0%}."
        )
        if same:
            told += f" In {same} of {len(found)} seeds I is II: no examination was better than that of II by its noise."
        return told

    return say


def authority(bench: str) -> Sentence:
    """I against III, sine by sine."""

    def say(store: Store) -> str:
        found = pieces(store, f"rmse-{bench}-paper-I-{{}}", f"rmse-{bench}-III-{{}}")
        if not found:
            return ""
        ratios = np.mean([numbers(a["rmse"]) / numbers(b["rmse"]) for a, b in found], axis=0)
        sines = ", ".join(f"{ratio:.2f}" for ratio in ratios)
        most = " III has the largest gains of the authority: what I does with gains, it does with smaller ones."
        return f"I's RMSE over III's at the four sines: {sines}.{most if (ratios > 1.0).sum() > 1 else ''}"

    return say


def chattering(store: Store) -> str:
    """u' with and without."""
    told = []
    for chosen, name in (("none", "without a filter"), ("paper-short", "behind the paper's"), ("ours", "behind ours")):
        found = table(store, f"chatter-{chosen}-{{}}", "chatter")
        if len(found):
            told.append(f"{name} {found.mean():.4f} A/s")
    return _sentence(["u' is", *told]) if told else ""


def _relative(own: object, other: object) -> float:
    """Mean over the sines of own over other, less 1."""
    return float(np.mean(numbers(own) / numbers(other))) - 1.0


def _sentence(parts: list[str]) -> str:
    joined = ", ".join(parts).replace("is, ", "is ")
    return joined[:1].upper() + joined[1:] + "." if joined else ""


REASONS: Mapping[str, tuple[Sentence, ...]] = {
    "model": (analytic_is_near, network_error),
    "model-ours": (ours_is_identified,),
    "horizon": (horizon_ratio,),
    "epochs": (three_epochs,),
    "untouched": (corrections("stable"),),
    "unfiltered": (stopped("unstable", "none"),),
    "filtered": (stopped("unstable", "paper-short", "ours"), corrections("unstable")),
    "negative": (stopped("negative", "none", "paper-short", "ours"), corrections("negative")),
    "positive": (stopped("positive", "none", "paper-short", "ours"), corrections("positive")),
    "high": (stopped("high", "none", "paper-short", "ours"), corrections("high")),
    "bench": (handed_back("default"),),
    "bench-outside": (handed_back("outside"),),
    "fixed": (authority("default"),),
    "fixed-outside": (authority("outside"),),
    "slow": (authority("default"),),
    "chatter": (chattering,),
}
"""By the claim's key."""
