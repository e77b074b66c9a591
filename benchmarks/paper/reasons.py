# SPDX-License-Identifier: Apache-2.0
"""Why a claim came out as it did: sentences whose figures are the pieces', each said only where those bear it out.

A sentence is a function of the pieces; it is empty where they are not there or say something else. So no reason
outlives the figures that it was written for; where none is left the page says so (`MISSING`).
"""

from __future__ import annotations

from collections.abc import Mapping

from benchmarks.paper.reasons_learning import (
    analytic_is_near,
    hardly_unstable,
    horizon_ratio,
    network_error,
    ours_is_identified,
    three_epochs,
)
from benchmarks.paper.reasons_loop import (
    Sentence,
    authority,
    chattering,
    corrections,
    errors,
    handed_back,
    never_corrected,
    stopped,
)
from benchmarks.paper.store import Store

MISSING = "reason not written yet for these figures"

REASONS: Mapping[str, tuple[Sentence, ...]] = {
    "model": (analytic_is_near, network_error),
    "model-ours": (ours_is_identified,),
    "horizon": (horizon_ratio,),
    "epochs": (three_epochs, hardly_unstable),
    "untouched": (corrections("stable"), hardly_unstable),
    "unfiltered": (stopped("unstable", "none"),),
    "untouched-ours": (corrections("stable", "ours"),),
    "filtered": (stopped("unstable", "paper-short", "ours"), corrections("unstable"), hardly_unstable),
    "negative": (stopped("negative", "none", "paper-short", "ours"), corrections("negative"), hardly_unstable),
    "positive": (stopped("positive", "none", "paper-short", "ours"), corrections("positive"), hardly_unstable),
    "high": (stopped("high", "none", "paper-short", "ours"), corrections("high"), hardly_unstable),
    "bounded-ours": (errors("unstable", "negative", "positive", "high"),),
    "bench": (handed_back("default"),),
    "bench-outside": (handed_back("outside"),),
    "fixed": (authority("default"),),
    "fixed-outside": (authority("outside"),),
    "slow": (authority("default"),),
    "chatter": (chattering, never_corrected, hardly_unstable),
}
"""By the claim's key."""


def why(key: str, store: Store) -> str:
    """All sentences that hold for a claim at a size; `MISSING`: none does."""
    return " ".join(said for sentence in REASONS[key] if (said := sentence(store))) or MISSING
