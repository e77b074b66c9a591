# SPDX-License-Identifier: Apache-2.0
"""Arms the running plant for the node that has the authority, or disarms it, and prints the plant's answer.

Where no node has the authority it is armed at base gains. Anybody may disarm.

ros2 run hydro_bridge arm            # exit status 0 once the box confirms, 2 with the plant's reason if it refuses
ros2 run hydro_bridge arm --for trainer    # only if the trainer commands it
ros2 run hydro_bridge arm --off
"""

from __future__ import annotations

import argparse
from contextlib import suppress
from math import inf

import rclpy
from rclpy.node import Node

from hydro_bridge.cli.console import UserError, command
from hydro_bridge.ros.node import ros_arguments, start_ros
from hydro_bridge.ros.topics import CLAIM_SERVICE
from hydro_msgs.srv import Claim


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    result = argparse.ArgumentParser(prog="arm", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    result.add_argument("--off", action="store_true", help="disarm: the valve closes")
    result.add_argument("--for", dest="whom", default="", metavar="NODE", help="arm only if this node commands it")
    result.add_argument("--timeout", type=_seconds, default=10.0, metavar="S", help="for each step, default 10 s")
    return result


def _seconds(text: str) -> float:
    with suppress(ValueError):
        if 0.0 < (seconds := float(text)) < inf:
            return seconds
    raise argparse.ArgumentTypeError(f"{text}: must be a number of seconds above 0")


@command()
def main() -> None:
    """Entry point."""
    own, ros = ros_arguments()
    asked = parser().parse_args(own)
    if asked.off and asked.whom:
        raise UserError("--off disarms for everybody: leave --for out")
    start_ros(ros)
    node = Node("arm")
    try:
        print(ask(node, arm=not asked.off, timeout=asked.timeout, whom=asked.whom))
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def ask(node: Node, *, arm: bool, timeout: float, whom: str = "") -> str:
    """Ask the plant to arm or disarm, and return its answer; if `whom` is named, arm only if that node commands it.

    Raises UserError: there is no plant, it does not answer within `timeout` [s], or it refuses.
    """
    client = node.create_client(Claim, CLAIM_SERVICE)
    act = Claim.Request.ARM if arm else Claim.Request.DISARM
    request = Claim.Request(act=act, name="a person, by `arm`", whom=whom)
    if not client.wait_for_service(timeout_sec=timeout):
        raise UserError("no plant runs here: start a bridge or a simulation first")
    answer = client.call_async(request)
    rclpy.spin_until_future_complete(node, answer, timeout_sec=timeout)
    if not answer.done():
        raise UserError(f"the plant did not answer within {timeout:g} s: it may have acted or not; check its flags")
    if not answer.result().success:
        raise UserError(f"the plant refuses: {answer.result().message}")
    return str(answer.result().message)


if __name__ == "__main__":
    main()
