# SPDX-License-Identifier: Apache-2.0
"""Compilation at set-up: each compiled entry point of this package is called once, on small real inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hydro_filter.controller.factory import FilterChoice
from hydro_filter.controller.loop_filter import LoopFilterSettings, loop_filter
from hydro_filter.metric import ScheduledMetric
from hydro_sim.model.bench import Bench

EXAMPLE_EFFECTS: tuple[dict[str, Any], ...] = (
    {"id": "valve_lag", "parameters": {"bandwidth": 110.0, "damping": 0.8}},
    {"id": "friction_coulomb", "parameters": {"force": 12.0}},
    {"id": "leakage_internal", "parameters": {"coefficient": 1e-13}},
)
"""Effects typical of a diagnosed bench. Others are compiled at first use; new parameter values need no compilation."""


def _filters() -> None:
    """Compile the models of the shipped filter, of `EXAMPLE_EFFECTS`, and of a bench without effects."""
    FilterChoice(bench=Bench.nominal()).make(LoopFilterSettings())
    for effects in (EXAMPLE_EFFECTS, ()):
        loop_filter(ScheduledMetric.load(), replace(Bench.nominal(), effects=effects), Bench.nominal())


STEPS: dict[str, Callable[[], None]] = {"filter": _filters}
"""Compilation steps by the message shown while each runs."""
