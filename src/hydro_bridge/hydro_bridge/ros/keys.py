# SPDX-License-Identifier: Apache-2.0
"""Security by SROS2: enclaves of the executables, and whether security is enabled.

A process' enclave is its executable's, however it was started (network.md). ROS's own variables enable security, for a
process and its children. ROS reads only `true` as on, and silently runs unsecured if a key is missing, unless the
strategy is exactly `Enforce`. Here unrecognised values are refused, and Enforce is the default.
"""

from __future__ import annotations

import os

from hydro_core.settings import SettingsError

ENABLE_VARIABLE = "ROS_SECURITY_ENABLE"
STRATEGY_VARIABLE = "ROS_SECURITY_STRATEGY"
KEYSTORE_VARIABLE = "ROS_SECURITY_KEYSTORE"
ENFORCE = "Enforce"
_VALID_VALUES = {ENABLE_VARIABLE: ("true", "false"), STRATEGY_VARIABLE: (ENFORCE, "Permissive")}


def enclave_name(executable: str) -> str:
    """Return the name of an executable's enclave."""
    return f"/hydro/{executable}"


def security_enabled() -> bool:
    """Return whether security is enabled; if so, enforce it for this process and its children, unless the user chose.

    Raises SettingsError: a variable has a value that ROS would read as off.
    """
    for variable, meant in _VALID_VALUES.items():
        if (value := os.environ.get(variable, "")) and value not in meant:
            raise SettingsError(f"{variable}={value}: ROS knows {' and '.join(meant)} only, to the letter")
    if os.environ.get(ENABLE_VARIABLE) != "true":
        return False
    os.environ.setdefault(STRATEGY_VARIABLE, ENFORCE)
    return True
