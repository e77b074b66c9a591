# SPDX-License-Identifier: Apache-2.0
"""Start-up of all executables, before slow imports.

In a package's setup.py: "trainer = hydro_core.process.startup:main_of.hydro_policy.nodes.trainer"
"""

from __future__ import annotations

import io
import os
import signal
import sys
from importlib import import_module
from pathlib import Path

from hydro_core.errors import UserError
from hydro_core.process import termination

RMW_VARIABLE = "RMW_IMPLEMENTATION"
_TYPESUPPORT_INDEX = "share/ament_index/resource_index/rmw_typesupport"
_ROS_PACKAGES = (
    "rclpy",
    "hydro_msgs",
    "std_srvs",
    "diagnostic_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "ament_index_python",
)
_RMW_SELECTOR = "rmw_implementation"  # listed in the index as well, but not a middleware


def missing_middleware() -> str:
    """Return an error message if the selected ROS middleware is not installed; empty if it is, or is the default."""
    wanted = os.environ.get(RMW_VARIABLE, "")
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    installed = sorted(
        {path.name for prefix in prefixes for path in (prefix / _TYPESUPPORT_INDEX).glob("*")} - {_RMW_SELECTOR}
    )
    if not wanted or not installed or wanted in installed:
        return ""
    return f"{RMW_VARIABLE} is {wanted}, which is not installed: unset it, or take {' or '.join(installed)}"


def missing_working_directory() -> str:
    """Return an error message if the working directory was deleted; empty if it exists."""
    try:
        os.getcwd()
    except OSError:
        return "the folder in which this shell is has been deleted: go to another one"
    return ""


def copied_workspace() -> str:
    """Return an error message if the sourced workspace is a copy that links to the original's code; else empty."""
    here = Path(__file__).resolve()
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        if (sourced := Path(prefix).resolve()).name != "hydro_core" or not sourced.is_dir():
            continue
        workspace = sourced.parent.parent
        if sourced not in here.parents and workspace not in here.parents:
            return f"{workspace} was copied and still runs the code of {here.parents[4]}: run `make setup` in it first"
        return ""
    return ""


class LazyMain:
    """Entry point with a deferred import: `main_of.package.module()` imports package.module and runs its `main`."""

    def __init__(self, module: str = "") -> None:
        self._module = module

    def __getattr__(self, name: str) -> LazyMain:
        if name.startswith("__"):  # looked up by Python itself
            raise AttributeError(name)
        return LazyMain(f"{self._module}.{name}".lstrip("."))

    def __call__(self) -> int | None:
        """Install the signal handlers, import the module and run its `main`, which installs its own."""
        # Importing takes seconds, and a traceback would not help the user.
        termination.install_handlers(termination.exit_during_startup)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, termination.SIGNALS)  # blocked in a companion process until here
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(line_buffering=True)  # a pipe, too, gets each line as it is printed
        if trouble := missing_working_directory() or copied_workspace() or missing_middleware():
            termination.print_error(trouble)
            return 2
        try:
            status: int | None = import_module(self._module).main()
            return status
        except UserError as error:  # in a user's file read during the import, such as an effect
            termination.print_error(str(error))
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] not in _ROS_PACKAGES:
                raise
            missing = f"there is no {error.name} here: source a workspace"
            termination.print_error(f"this command is a ROS 2 node, and {missing}")
        finally:  # clean-up is complete, and Python's shutdown is not to be interrupted
            termination.install_handlers(signal.SIG_DFL)
        return 2


main_of = LazyMain()
