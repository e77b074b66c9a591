# SPDX-License-Identifier: Apache-2.0
"""`ros2 topic list|echo|hz`, `node list`, `service call` and `param get|set` where ROS 2 comes from wheels.

Arguments and output follow upstream's; ros2_verbs.md lists the differences. All other verbs need a full ROS 2.
`setup/ros2.py` calls this module; where a full ROS 2 is sourced, its own `ros2` is used instead.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from itertools import pairwise
from typing import Any

import rclpy
import yaml
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.task import Future

from hydro_bridge.ros.node import running_ros, spin
from hydro_bridge.ros.topics import qos_profile
from hydro_core.cli.console import UserError, command, make_parser

DISCOVERY_TIMEOUT = 10.0
"""Time-out [s] for the discovery of a topic or service; a lost announcement is repeated only after a few seconds."""


def interface_class(name: str, kind: str) -> type[Any]:
    """Return the class of an interface type such as `std_srvs/srv/SetBool`; the name may omit `kind` (msg or srv).

    Raises UserError: there is no type of that name.
    """
    package, _, rest = name.partition("/")
    try:
        found: type[Any] = getattr(import_module(f"{package}.{kind}"), rest.removeprefix(f"{kind}/"))
    except (ImportError, AttributeError, TypeError, ValueError):
        raise UserError(f"{name} is not a {kind} type known here: give package/{kind}/Name") from None
    return found


def to_plain(value: Any) -> Any:
    """Convert a message, or a value in one, to YAML types."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: to_plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return int.from_bytes(value, "little") if len(value) == 1 else list(value)
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [to_plain(entry) for entry in value]
    return value.item() if hasattr(value, "item") else value


def set_fields(message: Any, values: Mapping[str, Any]) -> None:
    """Set a message's fields from a mapping; raises UserError for an unknown field or a value of the wrong type.

    The message must be created with `check_fields=True`: otherwise ROS accepts any value, and fails on sending.
    """
    kinds = message.get_fields_and_field_types()
    for name, value in values.items():
        if name not in kinds:
            raise UserError(f"{type(message).__name__} has no field {name}; it has: {', '.join(kinds) or 'none'}")
        try:
            setattr(message, name, float(value) if isinstance(getattr(message, name), float) else value)
        except (AssertionError, TypeError, ValueError, OverflowError):
            raise UserError(f"{name}: {value!r} is no {kinds[name]}") from None


@contextmanager
def temporary_node() -> Iterator[Node]:
    """Context with a hidden node for queries of the graph; it has no parameter services."""
    with running_ros():
        node = Node(f"_ros2cli_{os.getpid()}", start_parameter_services=False, enable_rosout=False)
        try:
            yield node
        finally:
            node.destroy_node()


def holds(condition: Callable[[], object], timeout: float) -> bool:
    """Wait until `condition` holds, for `timeout` s; return whether it does."""
    end = time.monotonic() + timeout
    while not (found := condition()) and time.monotonic() < end:
        time.sleep(0.05)
    return bool(found)


def _list(options: argparse.Namespace) -> None:
    """List the graph once it has not changed for half a second, after 1 s at least and `DISCOVERY_TIMEOUT` at most."""
    with temporary_node() as node:
        begin = changed = now = time.monotonic()
        seen = -1
        while now < begin + 1.0 or (now < changed + 0.5 and now < begin + DISCOVERY_TIMEOUT):
            nodes, topics = node.get_node_names_and_namespaces(), node.get_topic_names_and_types()
            if len(nodes) + len(topics) != seen:
                seen, changed = len(nodes) + len(topics), now
            time.sleep(0.05)
            now = time.monotonic()
    named: list[tuple[str, list[str]]] = [(f"{namespace.rstrip('/')}/{name}", []) for name, namespace in nodes]
    for name, kinds in sorted(named if options.verb == "node list" else topics):
        if not any(part.startswith("_") for part in name.split("/")):  # hidden
            print(f"{name} [{', '.join(kinds)}]" if options.show_types else name)


def _topic_echo(options: argparse.Namespace) -> None:
    done = Future()

    def show(message: Any) -> None:
        text = yaml.safe_dump(to_plain(message), sort_keys=False, allow_unicode=True, width=float("inf"))
        print(f"{text}---", flush=True)
        if options.once:
            done.set_result(None)

    _listen(options.topic, show, done)


def _topic_hz(options: argparse.Namespace) -> None:
    """Count serialized messages on arrival, without decoding them."""
    times: deque[float] = deque(maxlen=5000)
    reported = 0.0

    def report() -> None:
        nonlocal reported
        stamps, told = list(times), "no new messages"
        steps = [later - earlier for earlier, later in pairwise(stamps)]
        if steps and stamps[-1] > reported:
            reported = stamps[-1]
            told = (
                f"average rate: {len(steps) / sum(steps):.3f}\n\tmin: {min(steps):.3f}s max: {max(steps):.3f}s "
                f"std dev: {statistics.pstdev(steps):.5f}s window: {len(stamps)}"
            )
        print(told, flush=True)

    _listen(options.topic, lambda _: times.append(time.monotonic()), Future(), report)


def _listen(topic: str, hear: Callable[[Any], None], done: Future, report: Callable[[], None] | None = None) -> None:
    """Pass each message to `hear` until a signal or `done`; with `report`, called each second, as bytes.

    An error of `hear` or `report`, such as a terminal closed by `| head`, is raised here: in a callback rclpy would
    print it, too.
    """

    def guarded(act: Callable[..., None]) -> Callable[..., None]:
        def acted(*message: Any) -> None:
            try:
                if not done.done():
                    act(*message)
            except Exception as error:
                done.set_exception(error)

        return acted

    with temporary_node() as node:
        topic = f"/{topic.removeprefix('/')}"
        if not holds(lambda: topic in dict(node.get_topic_names_and_types()), DISCOVERY_TIMEOUT):
            raise UserError(f"nobody publishes or hears {topic} (looked for {DISCOVERY_TIMEOUT:g} s)")
        kind = interface_class(dict(node.get_topic_names_and_types())[topic][0], "msg")
        holds(lambda: node.count_publishers(topic), 3.0)  # else the latched message of a later one is missed for good
        offered = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]  # all offer this QoS
        reliable = bool(offered) and all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
        latched = bool(offered) and all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
        qos = qos_profile(1000, reliable=reliable, latched=latched)
        node.create_subscription(kind, topic, guarded(hear), qos, raw=report is not None)
        if report is not None:
            node.create_timer(1.0, guarded(report))
        spin(node, done)
    if done.done():
        done.result()


def _service_call(options: argparse.Namespace) -> None:
    service, kind = f"/{options.service.removeprefix('/')}", interface_class(options.type, "srv")
    try:
        values = yaml.safe_load(options.values or "{}")
    except yaml.YAMLError:
        values = None
    if not isinstance(values, dict):
        raise UserError(f"{options.values!r}: give fields as YAML, such as '{{data: true}}'")
    request = kind.Request(check_fields=True)
    set_fields(request, values)
    with temporary_node() as node:
        client = node.create_client(kind, service)
        if not client.wait_for_service(timeout_sec=DISCOVERY_TIMEOUT):
            raise UserError(f"nobody offers {service} of type {options.type} (looked for {DISCOVERY_TIMEOUT:g} s)")
        print(f"requester: making request: {request}\n")
        print(f"response:\n{_answer(node, client.call_async(request), service)}\n")


def _answer(node: Node, asked: Future, service: str) -> Any:
    rclpy.spin_until_future_complete(node, asked, timeout_sec=DISCOVERY_TIMEOUT)
    if not asked.done():
        raise UserError(f"{service} gave no answer within {DISCOVERY_TIMEOUT:g} s")
    return asked.result()


def _param(options: argparse.Namespace) -> None:
    """Show a parameter, or set it: most of ours are read-only, which the node then says."""
    name = f"/{options.node.removeprefix('/')}"
    with temporary_node() as node:
        client = AsyncParameterClient(node, name)
        if not client.wait_for_services(timeout_sec=DISCOVERY_TIMEOUT):
            raise UserError(f"no node {name} with parameters was found within {DISCOVERY_TIMEOUT:g} s")
        if options.value is None:
            (value,) = _answer(node, client.get_parameters([options.name]), name).values or [None]
            if value is None or value.type == 0:
                raise UserError(f"{name} has no parameter {options.name}")
            print(parameter_value_to_python(value))
            return
        asked = Parameter(options.name, value=yaml.safe_load(options.value))
        (result,) = _answer(node, client.set_parameters([asked]), name).results
    if not result.successful:
        raise UserError(f"{name} refuses {options.name}: {result.reason}")
    print("Set parameter successful")


VERBS: dict[str, tuple[Callable[[argparse.Namespace], None], tuple[str, ...]]] = {
    "topic list": (_list, ("-t/--show-types",)),
    "topic echo": (_topic_echo, ("topic", "--once")),
    "topic hz": (_topic_hz, ("topic",)),
    "node list": (_list, ()),
    "service call": (_service_call, ("service", "type", "values")),
    "param get": (_param, ("node", "name")),
    "param set": (_param, ("node", "name", "value")),
}
"""What carries out a verb, and its arguments."""


@command()
def main() -> None:
    """Entry point."""
    name = " ".join(sys.argv[1:3])
    if name not in VERBS:
        raise UserError(f"`ros2 {name}` needs a full ROS 2 Jazzy; here are only run, {', '.join(VERBS)}")
    carry_out, words = VERBS[name]
    parser = make_parser(f"ros2 {name}", None)
    parser.set_defaults(verb=name, show_types=False, value=None)
    for word in words:
        how = {"action": "store_true"} if word.startswith("-") else {"nargs": "?" if word == "values" else None}
        parser.add_argument(*word.split("/"), **how)
    carry_out(parser.parse_args(sys.argv[3:]))
