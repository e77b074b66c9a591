# SPDX-License-Identifier: Apache-2.0
"""Terminations. The end of an episode's time is none: the next state's value is bootstrapped (truncation)."""

from __future__ import annotations

from typing import Any

from hydro_core.signals import FAULTS


def tripped(flags: Any) -> Any:
    """Return whether the box tripped on the force limit or a sensor; flags of a sample, or an array of such.

    Without these a box trips where it heard no commands, which is not due to the action.
    """
    return (flags & FAULTS) != 0
