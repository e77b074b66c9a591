# SPDX-License-Identifier: Apache-2.0
"""Library of effects: one small class per cause, grouped by component; `LIBRARY` holds all that can be claimed.

To add an effect, write its class and list it in its module's `EFFECTS`; nothing else changes. Laws that were found on
several benches are added by `diagnose --grow` (`grown`).
"""

from __future__ import annotations

from hydro_diagnosis.effects import bench_values, fluid, friction, grown, load, sensors, valve
from hydro_diagnosis.effects.base import Claim, Effect, FitParameter

LIBRARY: tuple[Effect, ...] = (
    *friction.EFFECTS, *fluid.LEAKAGE, *valve.EFFECTS, *fluid.EFFECTS, *sensors.EFFECTS, *load.EFFECTS,
    *bench_values.EFFECTS, *grown.EFFECTS,
)  # fmt: skip
"""Effects that can be claimed; several may share an id (chambers, sensors, forms of one cause)."""

CANDIDATES = (*LIBRARY, *bench_values.UNNAMED)
"""Effects that a search tries."""

__all__ = ["CANDIDATES", "LIBRARY", "Claim", "Effect", "FitParameter"]
