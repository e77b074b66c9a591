# SPDX-License-Identifier: Apache-2.0
"""`ros2 topic|node|service|bag|launch ...` without a full ROS 2."""

from __future__ import annotations

import argparse
import os
import re
import statistics
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

import rclpy
import yaml
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.task import Future

from hydro_bridge.bags.storage import Bag
from hydro_bridge.nodes.verbs.launch import launch
from hydro_bridge.ros.companion import CompanionError
from hydro_bridge.ros.node import running_ros, spin
from hydro_bridge.ros.topics import qos_profile
from hydro_core.cli.console import UserError, command

_ELEMENT_PATTERN = re.compile(r"(?:sequence<)?(\w+/\w+)(?:\[\d+\]|(?:, \d+)?>)?")
_LONG_TYPES = (bytes, bytearray, str)


def interface_class(name: str, kind: str) -> type[Any]:
    """Return the class of an interface type such as `std_srvs/srv/SetBool`; the name may omit `kind` (msg or srv).

    Raises UserError: there is no type of that name.
    """
    package, _, rest = name.partition("/")
    last = rest.removeprefix(f"{kind}/")
    try:
        found: type[Any] = getattr(import_module(f"{package}.{kind}"), last)
    except (ImportError, AttributeError, TypeError, ValueError):
        raise UserError(f"{name} is not a {kind} type known here: give package/{kind}/Name") from None
    return found


def to_plain(value: Any) -> Any:
    """Convert a message, or a value in one, to YAML types."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: to_plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return int.from_bytes(value, "little") if len(value) == 1 else list(value)
    if isinstance(value, Iterable) and not isinstance(value, _LONG_TYPES):
        return [to_plain(entry) for entry in value]
    return value.item() if hasattr(value, "item") else value


def set_fields(message: Any, values: Mapping[str, Any]) -> None:
    """Set a message's fields from a mapping; raises UserError for an unknown field or a value of the wrong type.

    The message must be created with `check_fields=True`: otherwise ROS accepts any value, and fails on sending.
    """

    def made(type_name: str, value: Any) -> Any:
        if not isinstance(value, Mapping):
            raise TypeError
        nested = interface_class(type_name, "msg")(check_fields=True)
        set_fields(nested, value)
        return nested

    kinds = message.get_fields_and_field_types()
    for name, value in values.items():
        if name not in kinds:
            raise UserError(f"{type(message).__name__} has no field {name}; it has: {', '.join(kinds) or 'none'}")
        nested = _ELEMENT_PATTERN.fullmatch(kinds[name])
        try:
            if isinstance(getattr(message, name), float):
                value = float(value)
            elif nested is not None:
                several = isinstance(value, Sequence)
                value = [made(nested[1], one) for one in value] if several else made(nested[1], value)
            setattr(message, name, value)
        except (AssertionError, TypeError, ValueError, OverflowError):
            raise UserError(f"{name}: {values[name]!r} is no {kinds[name]}") from None


_LIST_TIME_MIN = 1.0
"""s, minimum wait of `list`, which goes on until the graph has not changed for `_UNCHANGED_TIME`."""
DISCOVERY_TIMEOUT = 10.0
"""Time-out [s] for the discovery of a topic or service; a lost announcement is repeated only after a few seconds."""
_UNCHANGED_TIME = 0.5
_POLL_PERIOD = 0.05


@contextmanager
def temporary_node() -> Iterator[Node]:
    """Context with a hidden node for queries of the graph; it has no parameter services."""
    with running_ros():
        node = Node(f"_ros2cli_{os.getpid()}", start_parameter_services=False, enable_rosout=False)
        try:
            yield node
        finally:
            node.destroy_node()


def wait_for(condition: Callable[[], object], sentence: str, timeout: float = DISCOVERY_TIMEOUT) -> None:
    """Wait until `condition` holds; raises UserError with `sentence` after `timeout` s."""
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            raise UserError(f"{sentence} (looked for {timeout:g} s)")
        time.sleep(_POLL_PERIOD)


VERB_GROUPS = {
    "topic": "topics of the running graph: list, echo, hz",
    "node": "nodes of the running graph: list",
    "service": "services of the running graph: list, call",
    "bag": "recordings: info",
}
_QUEUE_DEPTH = 1000
_RATE_WINDOW = 5000
"""Messages that count for a rate."""
_REPORT_PERIOD = 1.0  # s
_PUBLISHER_TIMEOUT = 3.0  # s, for the first publisher to be discovered; the latched message of a later one is missed


class Parser(argparse.ArgumentParser):
    """Argument parser that raises one sentence as UserError, with a hint for commands that are not supported."""

    def error(self, message: str) -> NoReturn:
        """Refuse the command line; raises UserError."""
        raise UserError(f"{self.prog}: {message}; what is not in `{self.prog} --help` needs a full ROS 2 Jazzy")


@command(CompanionError)
def main() -> int | None:
    """Entry point."""
    result = Parser(prog="ros2", description=__doc__)
    groups = result.add_subparsers(dest="group", required=True, metavar="GROUP", parser_class=Parser)
    verbs = {}
    for name, summary in VERB_GROUPS.items():
        group = groups.add_parser(name, help=summary, description=summary, allow_abbrev=False)
        verbs[name] = group.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=Parser)

    def verb(group: str, name: str, text: str, run: Callable[[argparse.Namespace], None]) -> argparse.ArgumentParser:
        added = verbs[group].add_parser(name, help=text)
        added.set_defaults(carry_out=run, show_types=False)
        return added

    for name in ("topic", "service"):
        listing = verb(name, "list", f"names of all {name}s", _list)
        listing.add_argument("-t", "--show-types", action="store_true", help="with their types")
    verb("node", "list", "names of all nodes", _list)
    echo = verb("topic", "echo", "what is published, until Ctrl-C", _topic_echo)
    echo.add_argument("topic")
    echo.add_argument("--once", action="store_true", help="one message, then end")
    rate = verb("topic", "hz", "how often something is published, each second until Ctrl-C", _topic_hz)
    rate.add_argument("topic")
    call = verb("service", "call", "ask a service once, and show what it answers", _service_call)
    call.add_argument("service")
    call.add_argument("type", help="e.g. std_srvs/srv/SetBool")
    call.add_argument("values", nargs="?", default="", help="fields as YAML, e.g. '{data: false}'")
    info = verb("bag", "info", "what a recording holds; of a recorder that was killed or still runs, too", _bag_info)
    info.add_argument("bag", type=Path, metavar="BAG", help="a rosbag2 folder or an .mcap file")
    launching = groups.add_parser("launch", help="start what a launch file describes", allow_abbrev=False)
    launching.add_argument("package", help="or the path of a launch file")
    launching.add_argument("rest", nargs="*", metavar="FILE NAME:=VALUE", help="launch file and its arguments")
    launching.set_defaults(carry_out=lambda options: launch(options.package, options.rest))
    options = result.parse_args()
    status: int | None = options.carry_out(options)
    return status


def _list(options: argparse.Namespace) -> None:
    """Wait until the graph no longer changes, at least `_LIST_TIME_MIN`, at most `DISCOVERY_TIMEOUT`; list it."""
    with temporary_node() as node:
        begin = changed = now = time.monotonic()
        seen = -1
        while now < begin + _LIST_TIME_MIN or (now < changed + _UNCHANGED_TIME and now < begin + DISCOVERY_TIMEOUT):
            count = sum(1 for _ in node.get_node_names_and_namespaces()) + len(node.get_topic_names_and_types())
            if count != seen:
                seen, changed = count, now
            time.sleep(_POLL_PERIOD)
            now = time.monotonic()
        found: list[tuple[str, list[str]]] = node.get_topic_names_and_types()
        if options.group == "service":
            found = node.get_service_names_and_types()
        if options.group == "node":
            nodes = node.get_node_names_and_namespaces()
            found = [(f"{namespace.rstrip('/')}/{name}", []) for name, namespace in nodes]
    for name, kinds in sorted(found):
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
    times: deque[float] = deque(maxlen=_RATE_WINDOW)
    new = 0

    def count(_: bytes) -> None:
        nonlocal new
        times.append(time.monotonic())
        new += 1

    def report() -> None:
        nonlocal new
        stamps, told = list(times), "no new messages"
        steps = [later - earlier for earlier, later in pairwise(stamps)]
        if new > 0 and sum(steps) > 0.0:
            told = (
                f"average rate: {len(steps) / sum(steps):.3f}\n\tmin: {min(steps):.3f}s max: {max(steps):.3f}s "
                f"std dev: {statistics.pstdev(steps):.5f}s window: {len(stamps)}"
            )
        print(told, flush=True)
        new = 0

    _listen(options.topic, count, Future(), report)


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
        wait_for(lambda: topic in dict(node.get_topic_names_and_types()), f"nobody publishes or hears {topic}")
        kind = interface_class(dict(node.get_topic_names_and_types())[topic][0], "msg")
        with suppress(UserError):  # a subscriber may be discovered first: a latched message would be missed for good
            wait_for(lambda: node.count_publishers(topic), "", timeout=_PUBLISHER_TIMEOUT)
        offered = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]  # all offer this QoS
        reliable = bool(offered) and all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
        latched = bool(offered) and all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
        qos = qos_profile(_QUEUE_DEPTH, reliable=reliable, latched=latched)
        node.create_subscription(kind, topic, guarded(hear), qos, raw=report is not None)
        if report is not None:
            node.create_timer(_REPORT_PERIOD, guarded(report))
        spin(node, done)
    if done.done():
        done.result()


def _service_call(options: argparse.Namespace) -> None:
    service, kind, text = f"/{options.service.removeprefix('/')}", interface_class(options.type, "srv"), options.values
    try:
        values = yaml.safe_load(text) if text.strip() else {}
    except yaml.YAMLError as error:
        raise UserError(f"{text!r} is no YAML: {' '.join(str(error).split())}") from None
    if not isinstance(values, dict):
        raise UserError(f"{text!r}: give fields as YAML, such as '{{data: true}}'")
    request = kind.Request(check_fields=True)
    set_fields(request, values)
    with temporary_node() as node:
        wait_for(lambda: service in dict(node.get_service_names_and_types()), f"nobody offers the service {service}")
        offered = dict(node.get_service_names_and_types())[service]
        if f"{kind.__module__.partition('.')[0]}/srv/{kind.__name__}" not in offered:
            raise UserError(f"{service} is of type {', '.join(offered)}, not {options.type}")
        client = node.create_client(kind, service)
        if not client.wait_for_service(timeout_sec=DISCOVERY_TIMEOUT):
            raise UserError(f"{service} was not ready within {DISCOVERY_TIMEOUT:g} s")
        print(f"requester: making request: {request}\n")
        answer = client.call_async(request)
        rclpy.spin_until_future_complete(node, answer, timeout_sec=DISCOVERY_TIMEOUT)
        if not answer.done():
            raise UserError(f"{service} gave no answer within {DISCOVERY_TIMEOUT:g} s")
        print(f"response:\n{answer.result()}\n")


def _bag_info(options: argparse.Namespace) -> None:
    """Count a recording's messages in one pass, in the format of upstream's `ros2 bag info`, irregularities behind."""
    source = Bag(options.bag)
    counts: Counter[str] = Counter()
    times: list[int] = []
    kinds: dict[str, str] = {}
    for piece in source.pieces():
        counts[piece.topic] += len(piece.heads["log_time"])
        times += [int(piece.heads["log_time"].min()), int(piece.heads["log_time"].max())]
        kinds[piece.topic] = piece.schema.name
    topics = [
        f"Topic: {topic} | Type: {kind} | Count: {counts[topic]} | Serialization Format: cdr"
        for topic, kind in sorted(kinds.items())
    ]
    begin, end = min(times, default=0), max(times, default=0)
    size, units = float(sum(path.stat().st_size for path in source.files)), ["B", "KiB", "MiB", "GiB"]
    while size >= 1024.0 and len(units) > 1:
        size, units = size / 1024.0, units[1:]

    dates = []
    for time_ns in (begin, end):
        seconds, rest = divmod(time_ns, 1_000_000_000)
        words = datetime.fromtimestamp(seconds, timezone.utc).strftime("%b %d %Y %H:%M:%S")
        dates.append(f"{words}.{rest:09d} UTC ({seconds}.{rest:09d})")
    lines = {
        "Files:": "  ".join(path.name for path in source.files),
        "Bag size:": f"{size:.1f} {units[0]}",
        "Storage id:": "mcap",
        "Duration:": f"{1e-9 * (end - begin):.9f}s",
        "Start:": dates[0],
        "End:": dates[1],
        "Messages:": str(counts.total()),
        "Topic information:": f"\n{'':19}".join(topics),
    }
    print("\n".join([*(f"{name:<19}{value}" for name, value in lines.items()), *source.notes]))
