# SPDX-License-Identifier: Apache-2.0
"""What goes wrong in a soak: each fault begins, lasts, and is taken back; by when the plant must be safe."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

from rclpy.executors import SingleThreadedExecutor

from benchmarks.soak.crew import LEARNER
from hydro_bridge.ros.topics import AUTHORITY, create_subscription
from tests.attacks import ATTACKS, DISARMS, STAYS_ARMED, stranger

_WATCHDOG = 0.35
"""s: the box' watchdog of 200 ms, and what had been sent before."""
_FRESH = 0.5
"""s: the guard's 200 ms for gains and 20 ms for corrections, and its ramp to base gains."""
_ENDED = 2.0
"""s: a node looks for signals five times a second, then disarms."""
_FOUND = 3.5
"""s from which a stranger of the graph must have been found."""
_PERIOD = 0.005
"""s, of what a stranger does."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One thing that goes wrong."""

    cause: str
    strike: Callable[[Any], AbstractContextManager[Callable[[], None]]]
    """Begins it, given the soak (`crew`, `orders`); what is to be done again and again; its end takes it back."""
    lasts: float = 2.0
    """s until it is taken back."""
    safe_within: float | None = None
    """s within which the plant is disarmed with no current, or at base gains; None: it may go on."""
    stays_armed: bool = False
    """Whether it must not disarm the plant."""


Strike = Iterator[Callable[[], None]]
_WAIT = partial(time.sleep, 0.01)


@contextmanager
def _order(orders: tuple[str, ...], soak: Any) -> Strike:
    for order in orders:
        soak.orders.send(order)
    yield _WAIT
    soak.orders.send("hostile 0")


@contextmanager
def _signal(name: str, number: int, soak: Any) -> Strike:
    soak.crew.signal(name, number)
    try:
        yield _WAIT
    finally:
        if number == signal.SIGSTOP:
            soak.crew.signal(name, signal.SIGCONT)


@contextmanager
def _full_disk(names: tuple[str, ...], soak: Any) -> Strike:
    """No file grows any more: a quota of the kernel's, for these processes alone (EFBIG instead of ENOSPC)."""
    pids = [pid for name in names if (pid := soak.crew.pid(name))]
    before = {pid: resource.prlimit(pid, resource.RLIMIT_FSIZE) for pid in pids}
    for pid, (_, hard) in before.items():
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (1, hard))
    try:
        yield _WAIT
    finally:
        for pid, limits in before.items():
            with suppress(ProcessLookupError):
                resource.prlimit(pid, resource.RLIMIT_FSIZE, limits)


@contextmanager
def _busy(soak: Any) -> Strike:
    """Each core gets a process that computes without end."""
    with ExitStack() as stack:
        for _ in range(os.cpu_count() or 1):
            process = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(process.kill)
        yield _WAIT


@contextmanager
def _stranger(name: str, soak: Any) -> Strike:
    """One of `ATTACKS`, once more each time; a person arms again what was disarmed by hand."""
    with stranger() as node:
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        known = SimpleNamespace(epoch=0, sequence=0, subscribers=lambda topic: 0)
        create_subscription(node, AUTHORITY, lambda told: setattr(known, "epoch", told.epoch))
        send = ATTACKS[name](node, known)

        def once() -> None:
            executor.spin_once(timeout_sec=_PERIOD)
            send()
            time.sleep(_PERIOD)

        yield once
        executor.shutdown()
    if name == DISARMS:
        soak.crew.arm()


_SAFE_WITHIN = {
    "emulator": None, "bridge": _WATCHDOG, "filter": _FRESH, "trainer": _FRESH, "recorder": None, LEARNER: None,
}  # fmt: skip
"""s, by the process that is killed or stopped."""
FAULTS = (
    Fault(cause="unplug", strike=partial(_order, ("unplug 1.5",)), safe_within=_WATCHDOG),
    Fault(cause="stall of commands", strike=partial(_order, ("mute 1",)), safe_within=_WATCHDOG),
    Fault(cause="corrupt bytes", strike=partial(_order, ("hostile 100",)), stays_armed=True),
    Fault(cause="corrupt bytes alone", strike=partial(_order, ("hostile 100", "mute 1")), safe_within=_WATCHDOG),
    Fault(cause="replayed frames", strike=partial(_order, ("replay 400",))),
    *(
        Fault(cause=f"stranger: {name}", strike=partial(_stranger, name), lasts=4.0, safe_within=_FOUND)
        for name in ATTACKS
        if name not in STAYS_ARMED
    ),
    *(
        Fault(cause=f"{word} {name}", strike=partial(_signal, name, number), safe_within=within)
        for word, number in (("kill -9", signal.SIGKILL), ("SIGSTOP", signal.SIGSTOP))
        for name, within in _SAFE_WITHIN.items()
    ),
    *(
        Fault(cause=f"SIGHUP {name}", strike=partial(_signal, name, signal.SIGHUP), lasts=3.0, safe_within=within)
        for name, within in (("bridge", _ENDED), ("filter", _ENDED), ("trainer", _ENDED), ("recorder", None))
    ),
    Fault(cause="full disk: recorder", strike=partial(_full_disk, ("recorder",)), lasts=4.0),
    Fault(cause="full disk: trainer", strike=partial(_full_disk, ("trainer", LEARNER)), lasts=8.0),
    Fault(cause="CPU hogged", strike=_busy, lasts=4.0),
)
"""All of them. No clock is set: that needs rights over the whole machine (test_link.py steps the link's own)."""
