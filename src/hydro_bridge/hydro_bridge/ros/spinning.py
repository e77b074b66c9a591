# SPDX-License-Identifier: Apache-2.0
"""Execution of a node until a signal or shutdown."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import FrameType

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from hydro_bridge.process import endings
from hydro_bridge.ros.keys.enclave import enclave_arguments, key_error, security_enabled, verify_keys
from hydro_bridge.ros.network import stay_on_this_machine
from hydro_bridge.ros.parameters import refuse_unknown_parameters
from hydro_bridge.settings import SettingsError

_SLICE = 0.2


def ros_arguments(arguments: Sequence[str] | None = None) -> tuple[list[str], list[str]]:
    """Split a command line into a node's own arguments and those after `--ros-args` (up to `--`, if there is one)."""
    rest = list(sys.argv[1:] if arguments is None else arguments)
    if "--ros-args" not in rest:
        return rest, []
    begin = rest.index("--ros-args")
    end = rest.index("--", begin) + 1 if "--" in rest[begin:] else len(rest)
    return rest[:begin] + rest[end:], rest[begin:end]


def start_ros(ros: Sequence[str] = ()) -> None:
    """Start ROS without its signal handlers; ours leave time to disarm.

    See `network` for the discovery range, `keys.enclave` for the keys used if security is enabled.

    Raises
    ------
    SettingsError
        The arguments, `--ros-args` and what follows, cannot be used, or the keys cannot.
    """
    stay_on_this_machine()
    keys = security_enabled()
    try:
        rclpy.init(args=["hydro", *enclave_arguments(), *ros], signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # of which all of rclpy's are
        if keys:
            raise key_error(error) from None
        sentence = re.sub(r",? at /\S+:\d+", "", str(error))
        raise SettingsError(f"ROS refuses its arguments: {' '.join(sentence.split())}") from None
    if keys:
        verify_keys()


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
    executor = EventsExecutor()
    executor.add_node(node)
    ended: list[int] = []

    def hear(number: int, _: FrameType | None) -> None:
        endings.let_go_of_terminal()
        ended.append(number)

    before = endings.answer(hear)
    done: Future = Future() if until is None else until
    try:
        with suppress(ExternalShutdownException):
            while not ended and not done.done() and rclpy.ok():
                # In slices: without a deadline this executor (rclpy 7.1) keeps a core busy, may run no callback at all,
                # and gives Python no chance to take a signal.
                executor.spin_until_future_complete(done, timeout_sec=_SLICE)
    finally:
        try:
            executor.remove_node(node)
            executor.shutdown()
        finally:  # last: a second signal must not leave the node with a deleted executor
            endings.restore(before)
    return bool(ended)


def run_node(make: Callable[[], Node], ros: Sequence[str] = ()) -> None:
    """Start ROS, create the node, spin it, and shut down in order.

    Parameters
    ----------
    make
        Creates the node. Its method `begin`, if any, is called once its parameters are checked: anything that reaches
        a plant starts there. If it has a future `done`, spinning ends once that is done; never shut down in a callback,
        since the next one would find no context. Its method `close`, if any, is called while the context is still
        valid.
    ros
        Arguments from `--ros-args` on.
    """
    start_ros(ros)
    node = None
    try:
        node = make()
        refuse_unknown_parameters(node)
        getattr(node, "begin", _nothing)()
        spin(node, getattr(node, "done", None))
    finally:
        if node is not None:
            with endings.undisturbed():
                getattr(node, "close", _nothing)()
                node.destroy_node()
        rclpy.try_shutdown()


def _nothing() -> None:
    """Do nothing, for a node without `begin` or `close`."""
