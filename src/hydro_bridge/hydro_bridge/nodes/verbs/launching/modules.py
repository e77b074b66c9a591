# SPDX-License-Identifier: Apache-2.0
"""Loading of launch files, which are Python, and the modules that they import."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

from hydro_bridge.cli.console import UserError
from hydro_bridge.nodes.verbs.launching import description

_MODULES = {
    "launch": ("LaunchContext", "LaunchDescription", "LaunchDescriptionEntity", "Substitution"),
    "launch.actions": (
        "DeclareLaunchArgument", "ExecuteProcess", "IncludeLaunchDescription", "OpaqueFunction", "Shutdown",
    ),
    "launch.conditions": ("IfCondition",),
    "launch.launch_description_sources": ("PythonLaunchDescriptionSource",),
    "launch.substitutions": ("LaunchConfiguration", "PathJoinSubstitution"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.substitutions": ("ExecutableInPackage", "FindPackageShare"),
}  # fmt: skip


def provide() -> None:
    """Make the classes of `description` importable as `launch` and `launch_ros` in this process."""
    for name, names in _MODULES.items():
        module = ModuleType(name)
        module.__path__ = []
        for one in names:
            setattr(module, one, getattr(description, one))
        sys.modules[name] = module
        package, _, last = name.rpartition(".")
        if package:
            setattr(sys.modules[package], last, module)


def load(path: Path) -> description.LaunchDescription:
    """Load a launch file's description.

    Raises
    ------
    UserError
        The file is missing, is not a launch file in Python, or uses unsupported features.
    """
    scope: dict[str, object] = {"__name__": "launch_file", "__file__": str(path)}
    try:
        exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), scope)
        made = scope["generate_launch_description"]()  # type: ignore[operator]
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from None
    except (ImportError, AttributeError, NameError, TypeError) as error:
        raise UserError(f"{path.name} needs a full ROS 2 Jazzy: {error}") from None
    except (KeyError, SyntaxError, UnicodeDecodeError):
        raise UserError(f"{path.name} is no launch file in Python") from None
    if not isinstance(made, description.LaunchDescription):
        raise UserError(f"{path.name} describes nothing to launch")
    return made
