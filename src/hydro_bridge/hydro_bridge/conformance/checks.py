# SPDX-License-Identifier: Apache-2.0
"""Registry of the checks by their names in `cases.yaml`.

Each check evaluates the states received since the last step began, with the parameters given by the case. It returns
a sentence about what is wrong, or an empty string.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import getmembers, isfunction
from types import ModuleType

from hydro_bridge.conformance import command_checks, compensation_checks, line_checks, motion_checks


def _of(module: ModuleType) -> dict[str, Callable[..., str]]:
    """Return the public functions that a module defines."""
    return {
        name: function
        for name, function in getmembers(module, isfunction)
        if function.__module__ == module.__name__ and not name.startswith("_")
    }


CHECKS: dict[str, Callable[..., str]] = (
    _of(command_checks) | _of(compensation_checks) | _of(line_checks) | _of(motion_checks)
)
"""Checks by their names in `cases.yaml`."""
