# SPDX-License-Identifier: Apache-2.0
"""What holds for the tests of all packages."""

from __future__ import annotations

import fcntl
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import pytest

WORKER = "PYTEST_XDIST_WORKER"
"""Set by pytest-xdist in the processes that it starts."""


def pytest_configure(config: pytest.Config) -> None:
    """Take Ctrl-C and hang-ups as a terminal gives them, also where they are ignored: so would all that tests start.

    A shell's background job ignores the one, nohup the other; what has a handler here is by default in a new program.
    Each worker has a ROS domain of its own on this machine. Where tests are shared out, linear algebra has one thread
    in each: at these sizes more only wait for one another.
    """
    if config.getoption("numprocesses", default=None):  # before the workers start, which take it over
        os.environ.setdefault("OMP_NUM_THREADS", "1")
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, lambda *_: None)
    os.environ.setdefault("HYDRO_DASHBOARD", "off")  # tests of the live page start their own
    try:
        from hydro_bridge.ros.node import restrict_to_localhost
    except ModuleNotFoundError:  # nothing is built: no test has a graph
        return
    from tests.domains import own_domain

    restrict_to_localhost()
    stack = ExitStack()
    stack.enter_context(own_domain())
    config.add_cleanup(stack.close)


def pytest_itemcollected(item: pytest.Item) -> None:
    """Where tests are shared out, then by file: a file's fixtures are made once.

    Graph tests are in two groups, the whole graph's and the packages': they wait more than they compute, and each
    worker's nodes are in a domain of their own. A file that must not run beside a group names it as its own.
    """
    if item.get_closest_marker("xdist_group") is None:
        whole = "graph" if item.path.parent.name == "tests" else "graph of packages"
        item.add_marker(pytest.mark.xdist_group(whole if item.get_closest_marker("graph") else item.path.name))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Where tests are shared out, the graph's begin at once, on two workers, and what computes for long comes next.

    Those that need the machine for themselves are the first, one after the other: nobody else has to stop for them.
    """
    if WORKER in os.environ:
        first = ("graph", "realtime", "slow")
        items.sort(key=lambda item: [not item.get_closest_marker(marker) for marker in first])


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """What runs in real time has the machine for itself: where tests are shared out, the other worker waits for it."""
    if WORKER not in os.environ:
        return (yield)
    alone = item.get_closest_marker("realtime") is not None
    _MACHINE.take(item.config, alone=alone)
    try:
        return (yield)
    finally:
        if not (alone and nextitem is not None and nextitem.get_closest_marker("realtime")):
            _MACHINE.give()  # else what runs goes on between the two


class Machine:
    """A lock of all workers of a run: one test alone, or one of each worker."""

    def __init__(self) -> None:
        self._held: int | None = None

    def take(self, config: pytest.Config, *, alone: bool) -> None:
        """Wait for the machine; whoever wants it alone comes before the others' next tests."""
        if self._held is not None:
            return
        folder = Path(gettempdir(), f"hydro-tests-{config.workerinput['testrunuid']}")  # type: ignore[attr-defined]
        folder.mkdir(exist_ok=True)
        turn, self._held = (os.open(folder / name, os.O_CREAT | os.O_RDWR) for name in ("turn", "machine"))
        fcntl.flock(turn, fcntl.LOCK_EX)
        fcntl.flock(self._held, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        os.close(turn)

    def give(self) -> None:
        """Let the others go on."""
        assert self._held is not None
        os.close(self._held)
        self._held = None


_MACHINE = Machine()


@pytest.fixture
def domain() -> Iterator[None]:
    """One of the test's own, for what refuses to begin beside others."""
    from tests.domains import own_domain

    with own_domain():
        yield


@pytest.fixture
def start() -> Iterator[Callable[..., Any]]:
    """Start `package executable` with words, its `output` into a StringIO; all end with the test, the last first."""
    from hydro_bridge.ros.companion import Companion

    with ExitStack() as stack:

        def begin(command: str, *words: object, output: Any = None) -> Companion:
            take = output.write if output else None
            return stack.enter_context(Companion(*command.split(), list(map(str, words)), output=take))

        yield begin
