# SPDX-License-Identifier: Apache-2.0
"""Arms the running plant for the node that holds the lease, or disarms it, and prints the plant's answer.

Where no node holds the lease it is armed at base gains. Anybody may disarm.

ros2 run hydro_bridge arm            # exit status 0 once the box confirms, 2 with the plant's reason if it refuses
ros2 run hydro_bridge arm --for trainer    # only if the trainer commands it
ros2 run hydro_bridge arm --off
"""

from __future__ import annotations

from hydro_bridge.arguments import ros_arguments
from hydro_bridge.ros.node import call_service
from hydro_bridge.ros.topics import CLAIM_SERVICE
from hydro_core.cli.console import UserError, bounded_number, command, make_parser
from hydro_msgs.srv import Claim


@command()
def main() -> None:
    """Entry point."""
    parser = make_parser("arm", __doc__)
    parser.add_argument("--off", action="store_true", help="disarm: the valve closes")
    parser.add_argument("--for", dest="whom", default="", metavar="NODE", help="arm only if this node commands it")
    parser.add_argument("--timeout", type=bounded_number(0.01), default=10.0, metavar="S", help="for each step (10 s)")
    own, ros = ros_arguments()
    asked = parser.parse_args(own)
    if asked.off and asked.whom:
        raise UserError("--off disarms for everybody: leave --for out")
    act = Claim.Request.DISARM if asked.off else Claim.Request.ARM
    answer = call_service(
        "arm", ros, CLAIM_SERVICE, Claim, Claim.Request(act=act, name="a person, by `arm`", whom=asked.whom),
        absent="no plant runs here: start a bridge or a simulation first",
        unanswered=f"the plant did not answer within {asked.timeout:g} s: it may have acted or not; check its flags",
        refused="the plant refuses: ", discovery_timeout=asked.timeout, timeout=asked.timeout,
    )  # fmt: skip
    print(answer)
