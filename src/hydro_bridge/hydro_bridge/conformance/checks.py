# SPDX-License-Identifier: Apache-2.0
"""The checks by the name that they have in `cases.yaml`.

Each judges the states that came since the last step began, with the parameters that the case gives it: it returns a
sentence that says what is wrong, or nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import getmembers, isfunction
from types import ModuleType

from hydro_bridge.conformance import command_checks, line_checks, motion_checks


def _of(module: ModuleType) -> dict[str, Callable[..., str]]:
    """The public functions that a module defines."""
    return {
        name: function
        for name, function in getmembers(module, isfunction)
        if function.__module__ == module.__name__ and not name.startswith("_")
    }


CHECKS: dict[str, Callable[..., str]] = _of(command_checks) | _of(line_checks) | _of(motion_checks)
"""By the name in `cases.yaml`."""
