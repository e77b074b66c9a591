# SPDX-License-Identifier: Apache-2.0
"""A dead time of one row: a logger whose rows hold the current of the next row looks the same.

A current that is late, no cause makes: that is a mistake of wiring (`miswiring`).
"""

from __future__ import annotations

from collections.abc import Sequence

from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.findings import EffectReport

TIMING = 2e-5
"""Tolerance [s] of a dead time of one row."""


def current_is_early(problem: Problem, effects: Sequence[EffectReport]) -> str | None:
    """Return a sentence if a claimed dead time is one row: a current written a row before it acts looks the same."""
    rows = {model.step * model.spacing for model in problem.models}
    for effect in effects:
        bounds = effect.parameters["time"].ci95 if effect.id == "transport_delay" else None
        if bounds and any(bounds[0] - TIMING <= row <= bounds[1] + TIMING for row in rows):
            return (
                "the dead time is that of one row: a logger that writes each row's current a row before it acts looks "
                "the same; if this one does, move that column down by one row and diagnose again"
            )
    return None
