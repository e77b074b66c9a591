# SPDX-License-Identifier: Apache-2.0
"""Companion processes: executables of our packages that start and end with the program that needs them.

Each runs in a process group of its own. None outlives its parent: not on a clean exit, not on an error, and not on
`kill -9`, for the kernel then sends it SIGTERM (PR_SET_PDEATHSIG). A recorder is required for arming, a live page is
optional.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from functools import partial
from math import inf
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from tqdm import tqdm

from hydro_bridge.ros.topics import DIAGNOSTICS, STATE, create_subscription
from hydro_bridge.safety.readiness import NotReadyError, Requirement
from hydro_core.process.termination import SIGNALS

_LIBC = ctypes.CDLL(None, use_errno=True)
_PR_SET_PDEATHSIG = 1
_ENCLAVE_OVERRIDE = "ROS_SECURITY_ENCLAVE_OVERRIDE"  # names this process' keys; a companion has its own


class CompanionError(Exception):
    """A companion process cannot be started; the message is one clear sentence."""


def executable_path(package: str, executable: str) -> Path:
    """Return the path of a package's executable from the ament index; raises CompanionError."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix, "lib", package, executable)
        if prefix and os.access(path, os.X_OK):
            return path
    raise CompanionError(f"{package} has no executable {executable} here: build, and source install/setup.bash")


class Companion(AbstractContextManager["Companion"]):
    """One process, started on construction; use as context manager, or call `stop`.

    Construct it in a thread that outlives the companion: the kernel ties the companion to this thread.

    Parameters
    ----------
    package, executable
        Names of package and executable, as for `ros2 run`.
    arguments
        Its command-line arguments.
    name
        Prefix of each line of its output; the executable's name by default.
    output
        Takes each line of its output; standard error by default, so that a progress bar or a table on standard output
        stays intact.
    """

    def __init__(
        self,
        package: str,
        executable: str,
        arguments: Sequence[str] = (),
        *,
        name: str = "",
        output: Callable[[str], object] | None = None,
    ) -> None:
        self.name = name or executable
        self._output = output or partial(print, end="", file=sys.stderr, flush=True)
        self._last_output = ""
        parent = os.getpid()
        self.process = subprocess.Popen(
            [str(executable_path(package, executable)), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env={name: value for name, value in os.environ.items() if name != _ENCLAVE_OVERRIDE},
            start_new_session=True,
            preexec_fn=lambda: _die_with(parent),  # noqa: PLW1509 - one call into libc, loaded before
        )
        self._echo = threading.Thread(target=self._repeat_output, name=f"output of {self.name}", daemon=True)
        self._echo.start()

    @property
    def running(self) -> bool:
        """Whether the process still runs."""
        return self.process.poll() is None

    @property
    def last_line(self) -> str:
        """Its last line of output; once it has ended, all output has been read."""
        if not self.running:
            self._echo.join(1.0)
        return self._last_output

    def stop(self, timeout: float = 5.0) -> int:
        """End the process group by SIGINT, after `timeout` s by SIGKILL; returns its status, negative for a signal."""
        if self.running:
            self._signal(signal.SIGINT)
            try:
                self.process.wait(timeout)
            except subprocess.TimeoutExpired:
                with suppress(OSError, ValueError):  # nobody reads any more: it is ended all the same
                    self._output(f"[{self.name}] did not end within {timeout:g} s: killed\n")
        self._signal(signal.SIGKILL)  # the rest of its process group
        status = self.process.wait()
        self._echo.join(1.0)
        return status

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _signal(self, number: int) -> None:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, number)

    def _repeat_output(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                self._last_output = line.strip() or self._last_output
                with suppress(ValueError, OSError):  # the program's output is closed already
                    self._output(f"[{self.name}] {line.rstrip()}\n")


def _die_with(parent: int) -> None:
    """Make the child, before exec, die with its parent, even if that has just died."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # the parent's handler would only record it, and vanish at exec
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # until it answers them (hydro_core.process.startup)
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)


RECORDER_TIMEOUT = 60.0
"""Time limit [s] for a recorder to have samples once they arrive: on a busy machine discovery takes some time."""


class RecorderMonitor:
    """Monitor of one recorder by its diagnostics: whether it has received samples.

    `node`: node that subscribes to /diagnostics. `folder`: folder of the recording, as passed to the recorder.
    `recorder`: its process.
    """

    def __init__(self, node: Node, folder: Path, recorder: Companion) -> None:
        self.since = inf
        """Time of its first report of samples, s of the monotonic clock."""
        self._folder, self._recorder = str(folder), recorder
        create_subscription(node, DIAGNOSTICS, self._on_diagnostics)

    @property
    def requirement(self) -> Requirement:
        """Requirement for arming that the recorder has samples."""
        return Requirement(
            name="the recorder",
            ready=self._ready,
            hint="it says once a second how many samples it has",
            timeout=RECORDER_TIMEOUT,
            timeout_message=f"the recorder had no sample after {RECORDER_TIMEOUT:g} s: nothing is armed unrecorded",
            by_wall_clock=True,
        )

    def _ready(self) -> bool:
        if self.since == inf and not self._recorder.running:
            raise NotReadyError("the recorder ended before it had a sample: nothing is armed unrecorded")
        return self.since < inf

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {entry.key: entry.value for entry in status.values}
            if values.get("folder") == self._folder and values.get(STATE, "0") != "0":
                self.since = min(self.since, time.monotonic())


DASHBOARD_VARIABLE = "HYDRO_DASHBOARD"
DASHBOARD_NODE = "dashboard"
_ADDRESS_PREFIX = "the live page: "


def dashboard_enabled() -> bool:
    """Return whether this environment starts a live page by default."""
    return os.environ.get(DASHBOARD_VARIABLE, "") != "off"


def add_dashboard_option(parser: argparse._ActionsContainer) -> None:
    """Add the option --no-dashboard."""
    parser.add_argument(
        "--no-dashboard",
        dest="dashboard",
        action="store_false",
        default=dashboard_enabled(),
        help=f"serve no live page beside the run (nor where {DASHBOARD_VARIABLE}=off)",
    )


def start_dashboard(
    stack: ExitStack, node: Node, *, wanted: bool, log: Callable[[str], object] = lambda line: None
) -> None:
    """Start a dashboard process, unless the graph already has one; `stack` ends it. Call before arming.

    A failure of the dashboard does not affect the run.

    `node`: node of the caller. `wanted`: False: no page. `log`: receives each line of its output except its address,
    which contains the token and goes to the terminal only.
    """
    if not wanted or DASHBOARD_NODE in node.get_node_names():
        return

    def take(line: str) -> None:
        if _ADDRESS_PREFIX not in line:
            log(line)
            return
        with suppress(OSError, ValueError):  # the terminal has gone
            tqdm.write(line.partition("] ")[2].rstrip("\n"), file=sys.stderr)

    with suppress(CompanionError):
        stack.enter_context(Companion("hydro_bridge", DASHBOARD_NODE, output=take))
