# SPDX-License-Identifier: Apache-2.0
"""Start-up of all executables, before slow imports.

In a package's setup.py: "trainer = hydro_core.process.startup:main_of.hydro_policy.nodes.trainer"
"""

from __future__ import annotations

import io
import os
import signal
import sys
import tempfile
from importlib import import_module

from hydro_core.errors import UserError
from hydro_core.process import termination

_ROS_PACKAGES = (
    "rclpy", "hydro_msgs", "std_srvs", "diagnostic_msgs", "rcl_interfaces", "rosgraph_msgs", "ament_index_python",
)  # fmt: skip


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
        termination.install(termination.exit_during_startup)
        if not os.environ.keys() & {"HOME", "ROS_HOME", "ROS_LOG_DIR"}:  # ROS would refuse to start
            os.environ["ROS_LOG_DIR"] = tempfile.gettempdir()
        signal.pthread_sigmask(signal.SIG_UNBLOCK, termination.SIGNALS)  # blocked in a companion process until here
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(line_buffering=True)  # a pipe, too, gets each line as it is printed
        try:
            status: int | None = import_module(self._module).main()
            return status
        except UserError as error:  # in a user's file read during the import, such as an effect
            termination.print_error(str(error))
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] not in _ROS_PACKAGES:
                raise
            termination.print_error(f"this ROS 2 node finds no {error.name}: source a workspace")
        finally:  # clean-up is complete, and Python's shutdown is not to be interrupted
            termination.install(signal.SIG_DFL)
        return 2


main_of = LazyMain()
