# SPDX-License-Identifier: Apache-2.0
"""Takes the gains away from the policy of a running trainer or evaluate, or gives them back. Ctrl-C is not needed.

ros2 run hydro_policy override --kp 60 --ki 10 --seconds 30
ros2 run hydro_policy override --kp 60 --ki 10      # until --off, or until the trainer ends
ros2 run hydro_policy override --off
ros2 run hydro_policy override --kp 60 --ki 10 --of trainer    # only of a node of this name
"""

from __future__ import annotations

from hydro_bridge.arguments import ros_arguments
from hydro_bridge.ros.node import call_service
from hydro_bridge.ros.topics import OVERRIDE_SERVICE
from hydro_core.cli.console import UserError, command, make_parser
from hydro_msgs.srv import OverrideGains

DISCOVERY_TIMEOUT = 10.0  # s, to find the service: a busy machine loses announcements, repeated each few seconds
ANSWER_TIMEOUT = 3.0  # s, for its answer
_REQUESTER = "a person, by `override`"


@command()
def main() -> None:
    """Entry point."""
    parser = make_parser("override", __doc__)
    parser.add_argument("--kp", type=float, metavar="1/s", help="K_p in all, the box's base gain included")
    parser.add_argument("--ki", type=float, metavar="1/s^2", help="K_i in all")
    parser.add_argument("--seconds", type=float, default=0.0, metavar="S", help="give back after so long")
    parser.add_argument("--off", action="store_true", help="give back now")
    parser.add_argument("--of", dest="whom", default="", metavar="NODE", help="only if this node chooses the gains")
    own, ros = ros_arguments()
    options = parser.parse_args(own)
    given = (options.kp is not None) + (options.ki is not None)
    if given != (0 if options.off else 2):
        raise UserError("override needs --kp and --ki, or --off")
    gains = {} if options.off else {"proportional_gain": options.kp, "integral_gain": options.ki}
    seconds = 0.0 if options.off else options.seconds
    wanted = OverrideGains.Request(active=not options.off, name=_REQUESTER, whom=options.whom, seconds=seconds, **gains)
    answer = call_service(
        "override", ros, OVERRIDE_SERVICE, OverrideGains, wanted,
        absent=f"no trainer or evaluate found in {DISCOVERY_TIMEOUT:g} s: there are no gains to take over",
        unanswered=f"no answer within {ANSWER_TIMEOUT:g} s: look at the gains in /hydro/state, or ask again",
        discovery_timeout=DISCOVERY_TIMEOUT, timeout=ANSWER_TIMEOUT,
    )  # fmt: skip
    print(answer)
