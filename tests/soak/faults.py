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
from random import Random
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import SetBool

from hydro_bridge.ros.messages import reference_to_message
from hydro_bridge.ros.topics import ARM_SERVICE, AUTHORITY, CORRECTION, GAINS, GRAPH, REFERENCE, STATE
from hydro_bridge.signals import CorrectionStatus, Flag
from hydro_msgs.msg import Authority, BenchState, Correction, Gains
from tests.attacks import SHAKE, stranger
from tests.soak.crew import LEARNER, Crew
from tests.soak.wire import Wire

_WATCHDOG = 0.35
"""s: the box' watchdog of 200 ms, and what had been sent before."""
_FRESH = 0.5
"""s: the guard's 200 ms for gains and 20 ms for corrections, and its ramp to base gains."""
_ENDED = 2.0
"""s: a node looks for signals five times a second, then disarms."""
_FOUND = 3.5
"""s from which a stranger of the graph must have been found."""


@dataclass
class Scene:
    """Where it happens."""

    crew: Crew
    wire: Wire
    random: Random


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One thing that goes wrong."""

    cause: str
    strike: Callable[[Scene], AbstractContextManager[Callable[[], None]]]
    """Begins it; what is to be done again and again meanwhile; its end takes it back."""
    lasts: float = 2.0
    """s until it is taken back."""
    safe_within: float | None = None
    """s within which the plant is disarmed with no current, or at base gains; None: it may go on."""


def _nothing() -> None:
    time.sleep(0.01)


@contextmanager
def _order(order: str, scene: Scene) -> Iterator[Callable[[], None]]:
    scene.wire.order(order)
    yield _nothing
    scene.wire.order("hostile 0")


@contextmanager
def _signal(name: str, number: int, scene: Scene) -> Iterator[Callable[[], None]]:
    scene.crew.signal(name, number)
    yield _nothing


@contextmanager
def _stop(name: str, scene: Scene) -> Iterator[Callable[[], None]]:
    pid = scene.crew.pid(name)
    if pid:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield _nothing
    finally:
        with suppress(ProcessLookupError):
            if pid:
                os.kill(pid, signal.SIGCONT)


@contextmanager
def _full_disk(names: tuple[str, ...], scene: Scene) -> Iterator[Callable[[], None]]:
    """No file grows any more: a quota of the kernel's, for these processes alone (EFBIG instead of ENOSPC)."""
    before = {}
    for name in names:
        if pid := scene.crew.pid(name):
            before[pid] = resource.prlimit(pid, resource.RLIMIT_FSIZE)
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (1, before[pid][1]))
    try:
        yield _nothing
    finally:
        for pid, limits in before.items():
            with suppress(ProcessLookupError):
                resource.prlimit(pid, resource.RLIMIT_FSIZE, limits)


@contextmanager
def _busy(scene: Scene) -> Iterator[Callable[[], None]]:
    """Each core gets a process that computes without end."""
    with ExitStack() as stack:
        for _ in range(os.cpu_count() or 1):
            process = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(process.kill)
        yield _nothing


STRIKES: dict[str, Callable[[int], Any]] = {
    GAINS: lambda epoch: Gains(delta_kp=50.0, epoch=epoch),
    REFERENCE: lambda epoch: reference_to_message(SHAKE, epoch),
    CORRECTION: lambda epoch: Correction(delta_u=0.05, status=int(CorrectionStatus.MODIFIED), epoch=epoch),
    STATE: lambda epoch: BenchState(sequence=7, load_force=600.0, flags=int(Flag.TRIPPED)),
    AUTHORITY: lambda epoch: Authority(holder="stranger", claim=1, epoch=1),
    ARM_SERVICE: lambda epoch: SetBool.Request(data=False),
}
"""What is published or, by the service, asked for, given the epoch of the session."""
_PERIOD = 0.005  # s


@contextmanager
def intrude(name: str) -> Iterator[Callable[[], None]]:
    """A stranger of that name's kind; to be called again and again: it sends another one."""
    with stranger() as node:
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        heard: list[Any] = [Authority()]
        kind, qos = GRAPH[AUTHORITY]
        node.create_subscription(kind, AUTHORITY, lambda message: heard.__setitem__(0, message), qos)
        send = _caller(node) if name == ARM_SERVICE else _publisher(node, name)

        def once() -> None:
            executor.spin_once(timeout_sec=_PERIOD)
            send(STRIKES[name](heard[0].epoch))
            time.sleep(_PERIOD)

        yield once
        executor.shutdown()


def _publisher(node: Any, topic: str) -> Callable[[Any], None]:
    kind, qos = GRAPH[topic]
    return node.create_publisher(kind, topic, qos).publish  # type: ignore[no-any-return]


def _caller(node: Any) -> Callable[[Any], None]:
    client, asked = node.create_client(SetBool, ARM_SERVICE), []

    def ask(request: Any) -> None:
        if not asked and client.service_is_ready():
            asked.append(client.call_async(request))

    return ask


@contextmanager
def _stranger(name: str, scene: Scene) -> Iterator[Callable[[], None]]:
    with intrude(name) as once:
        yield once


def _killed(name: str, within: float | None) -> Fault:
    return Fault(cause=f"kill -9 {name}", strike=partial(_signal, name, signal.SIGKILL), safe_within=within)


def _stopped(name: str, within: float | None) -> Fault:
    return Fault(cause=f"SIGSTOP {name}", strike=partial(_stop, name), safe_within=within)


def _hung_up(name: str, within: float | None) -> Fault:
    return Fault(cause=f"SIGHUP {name}", strike=partial(_signal, name, signal.SIGHUP), lasts=3.0, safe_within=within)


_SAFE_WITHIN = {
    "emulator": None, "bridge": _WATCHDOG, "filter": _FRESH, "trainer": _FRESH, "recorder": None, LEARNER: None,
}  # fmt: skip
"""s, by the process that is killed or stopped."""
FAULTS = (
    Fault(cause="unplug", strike=partial(_order, "unplug 1.5"), safe_within=_WATCHDOG),
    Fault(cause="stall of commands", strike=partial(_order, "mute 1"), safe_within=_WATCHDOG),
    Fault(cause="corrupt bytes", strike=partial(_order, "hostile 100")),
    Fault(cause="replayed frames", strike=partial(_order, "replay 400")),
    *(
        Fault(cause=f"stranger: {name}", strike=partial(_stranger, name), lasts=4.0, safe_within=_FOUND)
        for name in STRIKES
    ),
    *(strike(name, within) for strike in (_killed, _stopped) for name, within in _SAFE_WITHIN.items()),
    _hung_up("bridge", _ENDED),
    _hung_up("filter", _ENDED),
    _hung_up("trainer", _ENDED),
    _hung_up("recorder", None),
    Fault(cause="full disk: recorder", strike=partial(_full_disk, ("recorder",)), lasts=4.0),
    Fault(cause="full disk: trainer", strike=partial(_full_disk, ("trainer", LEARNER)), lasts=8.0),
    Fault(cause="CPU hogged", strike=_busy, lasts=4.0),
)
"""All of them. No clock is set: that needs rights over the whole machine (test_link.py steps one that is injected)."""


def drawn(random: Random, causes: tuple[str, ...] = ()) -> Iterator[Fault]:
    """Faults in random order without end, each once before any comes again; some `causes` only where they are given."""
    chosen = [fault for fault in FAULTS if not causes or fault.cause in causes]
    while chosen:
        yield from random.sample(chosen, len(chosen))
