# SPDX-License-Identifier: Apache-2.0
"""Security by SROS2: enclave of this process, and whether its keys are usable.

A process' enclave is its executable's, however it was started (network.md). ROS's own variables enable security, for a
process and its children. ROS reads only `true` as on, and silently runs unsecured if a key is missing, unless the
strategy is exactly `Enforce`. Here unrecognised values are refused, and Enforce is the default.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from hydro_bridge.ros.topics import RIGHTS, hidden_node
from hydro_core.settings import SettingsError

ENABLE = "ROS_SECURITY_ENABLE"
STRATEGY = "ROS_SECURITY_STRATEGY"
KEYSTORE = "ROS_SECURITY_KEYSTORE"
ENFORCE = "Enforce"
_MEANT = {ENABLE: ("true", "false"), STRATEGY: (ENFORCE, "Permissive")}


def enclave_name(executable: str) -> str:
    """Return the name of an executable's enclave."""
    return f"/hydro/{executable}"


def enclave_arguments() -> list[str]:
    """Return the ROS arguments that select this executable's enclave, unless the user has given others.

    The enclave is named with and without keys, so that both use the same start-up path.
    """
    executable = Path(sys.argv[0]).stem
    return ["--ros-args", "--enclave", enclave_name(executable)] if executable in RIGHTS else []


def security_enabled() -> bool:
    """Whether security is enabled; if so, enforce it for this process and its children unless the user has chosen.

    Raises SettingsError: a variable has a value that ROS would read as off.
    """
    for variable, meant in _MEANT.items():
        if (value := os.environ.get(variable, "")) and value not in meant:
            raise SettingsError(f"{variable}={value}: ROS knows {' and '.join(meant)} only, to the letter")
    if os.environ.get(ENABLE) != "true":
        return False
    os.environ.setdefault(STRATEGY, ENFORCE)
    return True


def verify_keys() -> None:
    """Create and destroy a context with this enclave, so that missing or rejected keys fail at the start.

    Raises SettingsError: this enclave has no keys, or the middleware has no security.
    """
    try:
        hidden_node("_hydro_keys").destroy_node()
    except RuntimeError as error:
        raise key_error(error) from None


def key_error(error: RuntimeError) -> SettingsError:
    """Return ROS's error about unusable keys as one sentence."""
    said = " ".join(re.sub(r",? at /\S+:\d+", "", str(error)).split())
    keystore = os.environ.get(KEYSTORE) or "not set"
    return SettingsError(
        f"ROS does not start with keys ({KEYSTORE}: {keystore}): {said}; "
        "`ros2 security` makes them, as docs/manual/explanation/network.md says"
    )
