# SPDX-License-Identifier: Apache-2.0
"""Overlap and null shift of a valve, from the effects of a bench file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

OVERLAP_EFFECT = "valve_deadband"
"""Id of the valve's overlap, a range of currents that gives no flow."""
LEAP = 2e-3
"""Share of the largest current, to either side of the closed valve, over which a force law leaps over the overlap."""


def null_shifts(effects: Iterable[Mapping[str, Any]]) -> tuple[float, float]:
    """Return the null shifts [A] before and after the valve's lag, in the order of the bench file."""
    shifts, behind = [0.0, 0.0], False
    for effect in effects:
        behind = behind or effect["id"] == "valve_lag"
        if effect["id"] == "valve_offset":
            shifts[behind] += effect["parameters"]["current"]
    return shifts[0], shifts[1]


def valve_overlap(effects: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Return the overlap of a bench's valve [A], summed over its effects.

    `closing`: current that closes the valve; `back`, `out`: half widths of negative openings and of others.
    """
    effects = tuple(effects)
    closing, back, out = -sum(null_shifts(effects)), 0.0, 0.0
    for effect in effects:
        if effect["id"] == OVERLAP_EFFECT:
            widths = effect["parameters"]
            out += widths["half_width"]
            back += widths.get("half_width_negative", widths["half_width"])
    return {"closing": closing, "back": back, "out": out}
