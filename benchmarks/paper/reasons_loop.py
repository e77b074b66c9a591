# SPDX-License-Identifier: Apache-2.0
"""Sentences of `reasons` about closed loops: the filter's trials, the agents, chattering in training."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.paper.store import Store
from benchmarks.paper.verdicts import numbers, pieces, table

Sentence = Callable[[Store], str]


def corrections(case: str, chosen: str = "paper-short") -> Sentence:
    """How much a filter corrects and how often its certificate is violated, before and after."""

    def say(store: Store) -> str:
        found = table(store, f"validation-{case}-{chosen}-{{}}", "gammas")
        if not len(found):
            return ""
        size, before, _, after, _ = found.mean(0)
        told = f"It corrects by {size:.2g} % of the largest current; M_c > 0 in {before:.0f} % of the samples"
        return f"{told} before and {after:.0f} % after."

    return say


def errors(*cases: str) -> Sentence:
    """Force RMSE behind our filter and without one."""

    def say(store: Store) -> str:
        told = []
        for case in cases:
            found = pieces(store, f"validation-{case}-ours-{{}}", f"validation-{case}-none-{{}}")
            own, bare = (np.mean([one[place]["rmse"] for one in found]) if found else np.nan for place in (0, 1))
            if found:
                told.append(f"{own:.1f} N behind it and {bare:.1f} N without one ({case})")
        return "RMSE is " + ", ".join(told) + "; of a run that tripped, up to there." if told else ""

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
        chosen, last = (100.0 * np.mean([_relative(a[key], b["rmse"]) for a, b in found]) for key in ("rmse", "last"))
        episodes = store.size.bench_episodes
        told = f"RMSE after {episodes} episodes, to II's: I {chosen:+.0f} %, its last policy {last:+.0f} %."
        if same:
            told += f" In {same} of {len(found)} I is II: no examination was better than that of II by its noise."
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
        trips = int(table(store, f"chatter-{chosen}-{{}}", "trips").sum()) if len(found) else 0
        if len(found):
            told.append(f"{name} {found.mean():.4f} A/s" + (f" with {trips} trips" if trips else ""))
    return f"RMS of u': {', '.join(told)}." if told else ""


def never_corrected(store: Store) -> str:
    """Where our filter finds nothing to do."""
    found = pieces(store, "chatter-ours-{}", "chatter-none-{}")
    if not found or any(ours["chatter"] != none["chatter"] for ours, none in found):
        return ""
    return "Behind ours it is that without a filter to the bit: these gains give it nothing to correct."


def _relative(own: object, other: object) -> float:
    """Mean over the sines of own over other, less 1."""
    return float(np.mean(numbers(own) / numbers(other))) - 1.0


def _sentence(parts: list[str]) -> str:
    joined = ", ".join(parts)
    return joined[:1].upper() + joined[1:] + "." if joined else ""
