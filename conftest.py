# SPDX-License-Identifier: Apache-2.0
"""What holds for the tests of all packages."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from typing import Any

import pytest

WORKER = "PYTEST_XDIST_WORKER"
"""Set by pytest-xdist in the processes that it starts."""


def pytest_configure() -> None:
    """Take Ctrl-C and hang-ups as a terminal gives them, also where they are ignored: so would all that tests start.

    A shell's background job ignores the one, nohup the other; what has a handler here is by default in a new program.
    No live page is beside each run. Tests' own nodes stay on this machine and are found as soon as those of the
    executables. Each worker has a ROS domain of its own: nodes that one starts are not in the graphs of the other.
    """
    if WORKER in os.environ:
        domain = int(os.environ.get("ROS_DOMAIN_ID", "0")) + int(os.environ[WORKER].removeprefix("gw"))
        os.environ["ROS_DOMAIN_ID"] = str(domain)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, lambda *_: None)
    os.environ.setdefault("HYDRO_DASHBOARD", "off")  # tests of the live page start their own
    with suppress(ModuleNotFoundError):  # nothing is built
        from hydro_bridge.ros.node import stay_on_this_machine

        stay_on_this_machine()


def pytest_itemcollected(item: pytest.Item) -> None:
    """Where tests are shared out, then by file: a file's fixtures are made once. Graph tests stay together."""
    group = "graph" if item.get_closest_marker("graph") else item.path.name
    item.add_marker(pytest.mark.xdist_group(group))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Where tests are shared out, the graph's begin at once, on one worker, and what computes for long comes next."""
    if WORKER in os.environ:
        items.sort(key=lambda item: (not item.get_closest_marker("graph"), not item.get_closest_marker("slow")))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker gives way to the graph tests of the other one, which run in real time, from its first other test on."""
    if WORKER in os.environ and not item.get_closest_marker("graph"):
        os.nice(19)  # 19 is the most there is, however often it is asked for


@pytest.fixture
def start() -> Iterator[Callable[..., Any]]:
    """Start `package executable` with words, its `output` into a StringIO; all end with the test, the last first."""
    from hydro_bridge.ros.companion import Companion

    with ExitStack() as stack:

        def begin(command: str, *words: object, output: Any = None) -> Companion:
            take = output.write if output else None
            return stack.enter_context(Companion(*command.split(), list(map(str, words)), output=take))

        yield begin
