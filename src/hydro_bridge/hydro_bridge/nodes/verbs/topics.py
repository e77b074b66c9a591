# SPDX-License-Identifier: Apache-2.0
"""`ros2 topic list|info|type|echo|hz`."""

from __future__ import annotations

import argparse
import statistics
import time
from collections import deque
from contextlib import suppress
from itertools import pairwise
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future

from hydro_bridge.cli.console import UserError
from hydro_bridge.nodes.verbs.graph import (
    absolute,
    add_list_options,
    add_spin_time,
    print_list,
    settle,
    visiting,
    wait_for,
)
from hydro_bridge.nodes.verbs.values import as_csv, as_yaml, interface, part, plain, without
from hydro_bridge.ros.node import spin

GROUP, HELP = "topic", "topics of the running graph: list, info, type, echo, hz"
_DEPTH = 1000
_REPORT = 1.0  # s
_PUBLISHER = 3.0  # s, for the first publisher to be discovered; a later one is heard, but not its latched message


def add_verbs(verbs: Any) -> None:
    """Add the group's verbs."""
    several = verbs.add_parser("list", help="names of all topics")
    add_list_options(several, "topics")
    several.set_defaults(carry_out=_list)
    info = verbs.add_parser("info", help="a topic's type, and who publishes and subscribes to it")
    info.add_argument("topic")
    info.add_argument("-v", "--verbose", action="store_true", help="each of them by name, with quality of service")
    add_spin_time(info)
    info.set_defaults(carry_out=_info)
    kind = verbs.add_parser("type", help="a topic's type")
    kind.add_argument("topic")
    kind.set_defaults(carry_out=_type)
    echo = verbs.add_parser("echo", help="what is published, until Ctrl-C")
    echo.add_argument("topic")
    echo.add_argument("type", nargs="?", help="default: what its publishers say")
    echo.add_argument("--once", action="store_true", help="one message, then end")
    echo.add_argument("--field", metavar="NAME", help="only this field, e.g. header.stamp")
    echo.add_argument("--csv", action="store_true", help="a message a line")
    echo.add_argument("--no-arr", action="store_true", help="of arrays only the length")
    echo.add_argument("--no-str", action="store_true", help="of strings only the length")
    echo.add_argument("-f", "--full-length", action="store_true", help="(always so here)")
    echo.set_defaults(carry_out=_echo)
    rate = verbs.add_parser("hz", help="how often something is published, each second until Ctrl-C")
    rate.add_argument("topic")
    rate.add_argument("-w", "--window", type=int, default=10_000, metavar="N", help="messages that count (10000)")
    rate.set_defaults(carry_out=_hz)


def _list(options: argparse.Namespace) -> None:
    with visiting() as node:
        settle(node, options.spin_time)
        print_list(options, node.get_topic_names_and_types())


def _info(options: argparse.Namespace) -> None:
    topic = absolute(options.topic)
    with visiting() as node:
        kinds = _kinds(node, topic)
        settle(node, options.spin_time)
        publishers, subscribers = node.get_publishers_info_by_topic(topic), node.get_subscriptions_info_by_topic(topic)
    print(f"Type: {', '.join(kinds)}\nPublisher count: {len(publishers)}")
    if options.verbose:
        print("".join(f"\n{endpoint}\n" for endpoint in publishers))
    print(f"Subscription count: {len(subscribers)}")
    if options.verbose:
        print("".join(f"\n{endpoint}\n" for endpoint in subscribers))


def _type(options: argparse.Namespace) -> None:
    with visiting() as node:
        print("\n".join(_kinds(node, absolute(options.topic))))


def _echo(options: argparse.Namespace) -> None:
    done = Future()

    def show(message: Any) -> None:
        if done.done():
            return
        try:
            print(_shown(message, options), flush=True)
        except Exception as error:  # raised here, rclpy would print it as well
            done.set_exception(error)
            return
        if options.once:
            done.set_result(None)

    with visiting() as node:
        topic = absolute(options.topic)
        kind = interface(options.type or _kinds(node, topic)[0], "msg")
        node.create_subscription(kind, topic, show, _heard_as_offered(node, topic))
        spin(node, done)
    if done.done():
        done.result()


def _shown(message: Any, options: argparse.Namespace) -> str:
    value = part(message, options.field) if options.field else message
    if options.no_arr or options.no_str:
        value = without(plain(value), arrays=options.no_arr, strings=options.no_str)
    return as_csv(value) if options.csv else f"{as_yaml(value)}---"


def _hz(options: argparse.Namespace) -> None:
    """Count serialized messages on arrival, without decoding them."""
    if options.window < 2:
        raise UserError(f"--window {options.window}: two messages or more make a rate")
    times: deque[float] = deque(maxlen=options.window)
    new, done = 0, Future()

    def count(_: bytes) -> None:
        nonlocal new
        times.append(time.monotonic())
        new += 1

    def report() -> None:
        nonlocal new
        if done.done():
            return
        try:
            print(_rate(times) if new else "no new messages", flush=True)
        except OSError as error:  # closed by `| head`; raised here, rclpy would print it
            done.set_exception(error)
        new = 0

    with visiting() as node:
        topic = absolute(options.topic)
        kind = interface(_kinds(node, topic)[0], "msg")
        node.create_subscription(kind, topic, count, _heard_as_offered(node, topic), raw=True)
        node.create_timer(_REPORT, report)
        spin(node, done)
    if done.done():
        done.result()


def _rate(times: deque[float]) -> str:
    stamps = list(times)
    steps = [later - earlier for earlier, later in pairwise(stamps)]
    if not steps or not sum(steps):
        return "no new messages"
    return (
        f"average rate: {len(steps) / sum(steps):.3f}\n\tmin: {min(steps):.3f}s max: {max(steps):.3f}s "
        f"std dev: {statistics.pstdev(steps):.5f}s window: {len(stamps)}"
    )


def _kinds(node: Node, topic: str) -> list[str]:
    """Return the types of a topic once they are announced; raises UserError."""
    wait_for(lambda: topic in dict(node.get_topic_names_and_types()), f"nobody publishes or hears {topic}")
    return list(dict(node.get_topic_names_and_types())[topic])


def _heard_as_offered(node: Node, topic: str) -> QoSProfile:
    """Return the QoS that all present publishers can serve: reliable, or latched, only if each of them is.

    A subscriber may be discovered before the publisher: a latched message would then be missed for good.
    """
    with suppress(UserError):
        wait_for(lambda: node.count_publishers(topic), "", patience=_PUBLISHER)
    offered = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    reliable = bool(offered) and all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
    latched = bool(offered) and all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
