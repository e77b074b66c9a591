# SPDX-License-Identifier: Apache-2.0
"""Library of effects: one small class per cause, grouped by component; `LIBRARY` holds all that can be claimed.

To add an effect, write its class and list it in its module's `EFFECTS`; nothing else changes. Laws that were found on
several benches are added by `diagnose --grow` (`grown`).
"""

from __future__ import annotations

from hydro_diagnosis.effects import (
    bench_values,
    direction,
    fluid,
    friction,
    grown,
    leakage,
    load,
    sensors,
    supply,
    unnamed,
    valve,
    valve_dynamics,
)
from hydro_diagnosis.effects.base import Claim, Effect, FitParameter

_MODULES = (friction, direction, leakage, valve, valve_dynamics, supply, fluid, sensors, load, bench_values, grown)

LIBRARY: tuple[Effect, ...] = tuple(effect for module in _MODULES for effect in module.EFFECTS)
"""Effects that can be claimed; several may share an id (chambers, sensors, forms of one cause)."""

CANDIDATES = (*LIBRARY, *unnamed.EFFECTS)
"""Effects that a search tries."""

__all__ = ["CANDIDATES", "LIBRARY", "Claim", "Effect", "FitParameter"]
