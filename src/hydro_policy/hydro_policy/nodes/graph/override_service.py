# SPDX-License-Identifier: Apache-2.0
"""Service /hydro/override, by which a person sets the gains while this node commands the plant."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node
from rclpy.service import Service

from hydro_bridge.ros.topics import OVERRIDE_SERVICE
from hydro_msgs.srv import OverrideGains
from hydro_policy.supervision.override import GainOverride


class OverrideService:
    """The service of one node.

    Parameters
    ----------
    node
        Node that offers the service.
    override
        Override that a request changes.
    warn
        Called with a sentence when a request is refused.
    fail
        Called with the error if the run's record cannot be written, which ends the run.
    told
        Called with the request and the answer.
    """

    def __init__(
        self,
        node: Node,
        override: Callable[[], GainOverride],
        warn: Callable[[str], None],
        fail: Callable[[Exception], None],
        told: Callable[[str], None],
    ) -> None:
        self._node, self._override = node, override
        self._service: Service | None = None
        self._warn, self._fail, self._told = warn, fail, told

    def open(self) -> None:
        """Offer the service unless it is already offered."""
        if self._service is None:
            self._service = self._node.create_service(OverrideGains, OVERRIDE_SERVICE, self._on_request)

    def close(self) -> None:
        """Withdraw it, so that the plant's new holder may offer it."""
        if self._service is not None:
            self._node.destroy_service(self._service)
        self._service = None

    def _on_request(self, request: OverrideGains.Request, answer: OverrideGains.Response) -> OverrideGains.Response:
        try:
            answer.message = self._carry_out(request)
            answer.success = True
        except ValueError as error:
            answer.success, answer.message = False, str(error)
            self._warn(f"override refused: {error}")
        except OSError as error:  # the run's record cannot be written
            answer.success, answer.message = False, str(error)
            self._fail(error)
        refused = "" if answer.success else "refused: "
        self._told(f"{request.name or 'somebody'}: override, {_wanted(request)}: {refused}{answer.message}")
        return answer

    def _carry_out(self, request: OverrideGains.Request) -> str:
        """Execute a request and return a sentence about it; raises ValueError, OSError."""
        own = self._node.get_name()
        if request.whom not in ("", own):
            raise ValueError(f"{own} chooses the gains here, not {request.whom}")
        if not request.active:
            return self._override().release()
        gains = (request.proportional_gain, request.integral_gain)
        return self._override().hold(*gains, request.seconds, time.monotonic())


def _wanted(request: OverrideGains.Request) -> str:
    if not request.active:
        return "give the gains back"
    return f"hold ({request.proportional_gain:g}, {request.integral_gain:g}) for {request.seconds:g} s"
