# SPDX-License-Identifier: Apache-2.0
"""Life cycle of a node: discovery range, parameters, scheduling, spinning until a signal or shutdown.

Discovery (network.md) stays on this machine, unless the user chooses otherwise by ROS's own variable,
`DISCOVERY_RANGE_VARIABLE`. LOCALHOST stops Fast DDS from multicasting, but not from listening on all addresses, and
adds shared memory, in which a plant's thread waits up to 333 ms for a new participant
(docs/decisions/0059-found-within-half-a-second.md). For Fast DDS everything is therefore set in
`FASTDDS_PROFILES_VARIABLE`: UDP, the loopback interface, no multicast; and the middleware is told to add nothing.
"""

from __future__ import annotations

import argparse
import gc
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, replace
from difflib import get_close_matches
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import get_rmw_implementation_identifier

from hydro_bridge.arguments import reaches, ros_arguments, sections
from hydro_bridge.ros.keys import KEYSTORE_VARIABLE, enclave_name, security_enabled
from hydro_bridge.ros.topics import ACCESS_RIGHTS, hidden_node
from hydro_core.errors import UserError
from hydro_core.process import termination
from hydro_core.process.realtime import limit_run_time
from hydro_core.settings import SettingsError, check, convert, describe, read_yaml

DISCOVERY_RANGE_VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
FASTDDS_PROFILES_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
LOCALHOST = "LOCALHOST"
SYSTEM_DEFAULT = "SYSTEM_DEFAULT"
"""Discovery range with which a middleware leaves its configuration as it is."""
DOMAIN_MAX = 232
"""Largest ROS_DOMAIN_ID: beyond, DDS has no ports."""
_LOCALHOST_ONLY_VARIABLE = "ROS_LOCALHOST_ONLY"  # takes precedence over `DISCOVERY_RANGE_VARIABLE` if set; deprecated


def restrict_to_localhost() -> None:
    """Restrict ROS discovery to this machine for this process and its children, unless the user has set otherwise.

    Call before ROS starts.
    """
    here = os.environ.setdefault(DISCOVERY_RANGE_VARIABLE, LOCALHOST) == LOCALHOST
    profile = str(resources.files("hydro_bridge.ros") / ("this_machine.xml" if here else "any_network.xml"))
    ours = os.environ.setdefault(FASTDDS_PROFILES_VARIABLE, profile) == profile
    if here and ours and get_rmw_implementation_identifier().startswith("rmw_fastrtps"):
        os.environ[DISCOVERY_RANGE_VARIABLE] = SYSTEM_DEFAULT  # the profile restricts it to this machine
        os.environ.pop(_LOCALHOST_ONLY_VARIABLE, None)


T = TypeVar("T")
NodeType = TypeVar("NodeType", bound=Node)


def declare_parameters(node: Node, settings: T, prefix: str = "") -> T:
    """Declare a read-only parameter for each field, and return the settings with the user's values.

    `settings`: instance of a settings dataclass: its values are the defaults. Fields other than numbers, strings and
    flags are skipped. `prefix`: prefix of each name, for instance ``guard.``. Raises SettingsError: a value has the
    wrong type or is out of range.
    """
    chosen: dict[str, Any] = {}
    for field in fields(settings):  # type: ignore[arg-type]
        default = getattr(settings, field.name)
        if isinstance(default, (bool, int, float, str)):
            name, setting = prefix + field.name, describe(type(settings))[field.name]
            descriptor = ParameterDescriptor(description=setting.text, read_only=True, dynamic_typing=True)
            if setting.range and setting.kind is float:
                limits = FloatingPointRange(from_value=float(setting.low), to_value=float(setting.high))
                descriptor.floating_point_range = [limits]
            elif setting.range:
                steps = IntegerRange(from_value=int(setting.low), to_value=int(setting.high), step=1)
                descriptor.integer_range = [steps]
            try:
                value = node.declare_parameter(name, default, descriptor).value
            except ParameterException as error:
                raise SettingsError(f"parameter {name}: {error}; {setting.text}") from None
            chosen[field.name] = convert(setting, value, f"parameter {name}", strict=True)
    declared = replace(settings, **chosen)  # type: ignore[type-var]
    check(declared)
    return declared


def declare_options(node: Node, options: argparse.Namespace) -> None:
    """Declare the options of a node's command line as read-only parameters, so that `ros2 param` shows what acts."""
    descriptor = ParameterDescriptor(read_only=True, dynamic_typing=True)
    for name, value in vars(options).items():
        several = value and isinstance(value, list | tuple)
        shown = [*map(str, value)] if several else value if isinstance(value, bool | int | float) else str(value or "")
        if not node.has_parameter(name):
            node.declare_parameter(name, shown, descriptor, ignore_override=True)


def refuse_unknown_parameters(*nodes: Node) -> None:
    """Raise for parameters and remapped names that no node has; ROS would ignore them silently.

    A file may hold the parameters of other nodes as well. Raises SettingsError: the user set a parameter, by name or
    in a file, that none of these nodes has, or that is addressed to no node; or remapped a name that none uses.
    """
    _refuse_unmatched_remaps(nodes)
    here = [node.get_fully_qualified_name() for node in nodes]
    ours = {node for table in ACCESS_RIGHTS.values() for node in table}
    for option, value in pairwise(ros_arguments()[1]):
        if option in ("-p", "--param") and ":" in (rule := value.partition(":=")[0]):
            patterns = ["/" + rule.partition(":")[0].lstrip("/")]
        elif option == "--params-file":
            patterns = sorted(pattern for pattern, _ in sections(read_yaml(value)))
        else:  # without a node's name a parameter is for all nodes
            continue
        reached = [each for each in patterns if any(reaches(each, name) for name in here)]
        for pattern in patterns:
            name = pattern.rpartition("/")[2]
            misspelt = name not in ours and get_close_matches(name, (*ours, *ACCESS_RIGHTS))
            if pattern not in reached and (misspelt or not reached):
                raise SettingsError(f"{value}: parameters of {pattern} reach no node, this is {' and '.join(here)}")
    for name in {name: None for node in nodes for name in node._parameter_overrides}:  # rclpy: no public access
        if not any(node.has_parameter(name) for node in nodes):
            close = get_close_matches(name, [known for node in nodes for known in node.get_parameters_by_prefix("")], 1)
            hint = f"; is {close[0]} meant?" if close else ""
            raise SettingsError(f"{' and '.join(node.get_name() for node in nodes)} has no parameter {name}{hint}")


def _refuse_unmatched_remaps(nodes: Sequence[Node]) -> None:
    """Raise SettingsError for a remapped topic or service that none of the nodes has under its new name."""
    names: set[str] = set()
    for node in nodes:
        for ask in (
            node.get_publisher_names_and_types_by_node, node.get_subscriber_names_and_types_by_node,
            node.get_service_names_and_types_by_node, node.get_client_names_and_types_by_node,
        ):  # fmt: skip
            names |= {name for name, _ in ask(node.get_name(), node.get_namespace())}
    for option, rule in pairwise(ros_arguments()[1]):
        before, _, after = rule.rpartition(":=")
        if option not in ("-r", "--remap") or before.rpartition(":")[2].startswith("__"):  # of a node's own name
            continue
        if not any(name == after or name.endswith(f"/{after.lstrip('~/')}") for name in names):
            raise SettingsError(
                f"--remap {rule}: {' and '.join(n.get_name() for n in nodes)} has no such name to remap"
            )


REALTIME_PRIORITY = 20
"""Priority under SCHED_FIFO, [1, 99]: above all ordinary processes, below the kernel's own threads."""


def request_realtime(*, realtime: bool, nice: int | None = None) -> str:
    """Freeze the garbage collector and, if requested, switch to SCHED_FIFO; returns a sentence with the outcome.

    Call it after all long-lived objects are created, which the collector then skips. Without permission for SCHED_FIFO
    (CAP_SYS_NICE, or rtprio in limits.conf) the process keeps ordinary scheduling. A process that never blocks under it
    is ended (`hydro_core.process.realtime`).

    A process without a deadline at the sample rate takes a `nice` instead, which its child processes do not inherit: on
    two cores it would exhaust the 95 % of time that the kernel leaves to SCHED_FIFO, which then stops the whole loop
    for 50 ms in every second (sched(7), sched_rt_runtime_us).
    """
    gc.collect()
    gc.freeze()
    if not realtime:
        return "ordinary scheduling"
    threads = map(int, os.listdir("/proc/self/task"))  # the middleware's as well
    try:
        if nice is not None:
            for thread in threads:
                os.sched_setscheduler(thread, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))
                os.setpriority(os.PRIO_PROCESS, thread, nice)
            return f"ordinary scheduling, nice {nice}"
        limit_run_time()
        for thread in threads:
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(REALTIME_PRIORITY))
    except OSError as error:
        return f"ordinary scheduling, {'SCHED_FIFO' if nice is None else f'nice {nice}'} was refused: {error.strerror}"
    return f"SCHED_FIFO, priority {REALTIME_PRIORITY}"


@contextmanager
def running_ros(ros: Sequence[str] = ()) -> Iterator[None]:
    """Context in which ROS runs, without its own signal handlers: those of `termination` leave time to disarm.

    See `restrict_to_localhost` for the discovery range. Unless the user gives another, the enclave is this executable's
    (`keys`), with and without keys, so that both use the same start-up path.

    Raises SettingsError: the domain, the arguments (`--ros-args` and what follows) or the keys cannot be used.
    """
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (domain.isascii() and domain.isdecimal() and int(domain) <= DOMAIN_MAX):
        raise SettingsError(f"ROS_DOMAIN_ID={domain}: must be a whole number from 0 to {DOMAIN_MAX}")
    restrict_to_localhost()
    keys, executable = security_enabled(), Path(sys.argv[0]).stem
    enclave = ["--ros-args", "--enclave", enclave_name(executable)] if executable in ACCESS_RIGHTS else []
    try:
        try:
            rclpy.init(args=["hydro", *enclave, *ros], signal_handler_options=SignalHandlerOptions.NO)
            if keys:  # a node with this enclave fails where keys are missing or rejected
                hidden_node("_hydro_keys").destroy_node()
        except RuntimeError as error:  # base class of all errors of rclpy
            sentence = " ".join(re.sub(r",? at /\S+:\d+", "", str(error)).split())
            if not keys:
                raise SettingsError(f"ROS refuses its arguments: {sentence}") from None
            keystore = os.environ.get(KEYSTORE_VARIABLE) or "not set"
            raise SettingsError(
                f"ROS does not start with keys ({KEYSTORE_VARIABLE}: {keystore}): {sentence}; "
                "`ros2 security` makes them, as docs/manual/explanation/network.md says"
            ) from None
        yield
    finally:
        rclpy.try_shutdown()


_EXECUTORS: WeakKeyDictionary[Node, Any] = WeakKeyDictionary()


def node_executor(node: Node) -> Any:
    """Return the node's executor, created on first use and kept for the node's life."""
    if node not in _EXECUTORS:
        _EXECUTORS[node] = EventsExecutor()
        _EXECUTORS[node].add_node(node)
    return _EXECUTORS[node]


def leave_graph(node: Node) -> None:
    """Destroy a node and its executor."""
    if (executor := _EXECUTORS.pop(node, None)) is not None:
        executor.remove_node(node)
        executor.shutdown()
    node.destroy_node()


def spin(node: Node, until: Future | None = None) -> bool:
    """Run the node's callbacks on an EventsExecutor until a signal or shutdown.

    Signals are SIGINT, SIGTERM and SIGHUP. The context stays valid, so the caller can still publish and disarm. Call it
    from the main thread.

    Parameters
    ----------
    until
        Return as soon as this future is done, too.

    Returns
    -------
    Whether a signal ended the spinning.
    """
    executor = node_executor(node)
    done: Future = Future() if until is None else until
    with termination.signals_noted() as ended, suppress(ExternalShutdownException):
        while not ended and not done.done() and rclpy.ok():
            # In slices: without a deadline this executor (rclpy 7.1) keeps a core busy, may run no callback at all,
            # and gives Python no chance to take a signal.
            executor.spin_until_future_complete(done, timeout_sec=0.2)
    return bool(ended)


def call_service(
    name: str, ros: Sequence[str], service: str, kind: type[Any], request: Any, *,
    absent: str, unanswered: str, refused: str = "", discovery_timeout: float, timeout: float,
) -> str:  # fmt: skip
    """Call a service once as the node `name`; return the message of its answer. `ros`: arguments from `--ros-args` on.

    Raises UserError: with `absent` if the service does not appear within `discovery_timeout` [s], with `unanswered` if
    no answer comes within `timeout` [s], with `refused` and the service's message if it refuses.
    """
    with running_ros(ros):
        node = Node(name)
        try:
            client = node.create_client(kind, service)
            if not client.wait_for_service(timeout_sec=discovery_timeout):
                raise UserError(absent)
            answer = client.call_async(request)
            rclpy.spin_until_future_complete(node, answer, timeout_sec=timeout)
            if not answer.done():
                raise UserError(unanswered)
            message = str(answer.result().message)
            if not answer.result().success:
                raise UserError(refused + message)
            return message
        finally:
            node.destroy_node()


def run_node(
    make: Callable[[], NodeType], ros: Sequence[str] = (), options: Sequence[argparse.Namespace] = ()
) -> NodeType:
    """Start ROS, create the node, spin it, and shut down in order; return it, destroyed, for its results.

    `make`: creates the node. Its method `begin`, if any, is called once its parameters are checked: anything that
    reaches a plant starts there. If it has a future `done`, spinning ends once that is done, and its exception, if any,
    is raised; never shut down in a callback, since the next one would find no context. Its method `close`, if any, is
    called while the context is still valid. Its `components`, if any, are further nodes, on the same executor. `ros`:
    arguments from `--ros-args` on. `options`: options of the node and of its components, in order.
    """
    with running_ros(ros):
        node = None
        try:
            node = make()
            components: Sequence[Node] = getattr(node, "components", ())
            nodes: list[Node] = [node, *components]
            for each, given in zip(nodes, options, strict=False):
                declare_options(each, given)
            refuse_unknown_parameters(*nodes)
            for component in components:
                node_executor(node).add_node(component)
            getattr(node, "begin", lambda: None)()
            done: Future | None = getattr(node, "done", None)
            spin(node, done)
            if done is not None and done.done():
                done.result()
            return node
        finally:
            if node is not None:
                with termination.signals_ignored():
                    getattr(node, "close", lambda: None)()
                    for component in components:
                        node_executor(node).remove_node(component)
                        component.destroy_node()
                    leave_graph(node)
