# SPDX-License-Identifier: Apache-2.0
"""Terminations of an episode. Its time limit is a truncation instead: the next state's value is bootstrapped."""

from __future__ import annotations

from typing import Any

from hydro_core.signals import FAULT_FLAGS


def tripped(flags: Any) -> Any:
    """Return whether the box reports a force-limit or sensor fault; `flags`: of a sample, or an array of them.

    A trip without these faults is due to missing commands, not to the action.
    """
    return (flags & FAULT_FLAGS) != 0
