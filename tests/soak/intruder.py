# SPDX-License-Identifier: Apache-2.0
"""A stranger in the graph of a soak: on each topic of the plant, with the epoch copied, and on its services."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import SetBool

from hydro_bridge.ros.messages import reference_to_message
from hydro_bridge.ros.topics import ARM_SERVICE, AUTHORITY, CORRECTION, GAINS, GRAPH, REFERENCE, STATE
from hydro_bridge.signals import CorrectionStatus, Flag
from hydro_msgs.msg import Authority, BenchState, Correction, Gains
from tests.attacks import SHAKE, stranger

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
