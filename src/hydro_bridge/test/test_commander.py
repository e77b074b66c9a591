# SPDX-License-Identifier: Apache-2.0
"""What a commanding node asks of the plant, on a running graph."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

import rclpy

from hydro_bridge.ros.commander import Commander
from hydro_bridge.ros.topics import CLAIM_SERVICE
from hydro_msgs.srv import Claim
from tests.checks import wait

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("domain")]


def test_a_lease_is_asked_for_by_a_clock_that_counts_from_zero_too() -> None:
    """By the plant's own, once it is known to have one, and by the monotonic clock before."""
    rclpy.init()
    node = rclpy.create_node("plant")

    def grant(_: Claim.Request, answer: Claim.Response) -> Claim.Response:
        answer.success, answer.claim, answer.epoch = True, 5, 7
        return answer

    node.create_service(Claim, CLAIM_SERVICE, grant)
    commander = Commander(node)

    def asked(now: float) -> bool:
        commander.renew_lease(now)
        rclpy.spin_once(node, timeout_sec=0.05)
        return commander.holds_lease

    wait(lambda: asked(15_000.0))
    rclpy.spin_until_future_complete(node, commander.release(), timeout_sec=10.0)
    assert not commander.holds_lease
    wait(lambda: asked(30.0))
    node.destroy_node()
    rclpy.shutdown()
