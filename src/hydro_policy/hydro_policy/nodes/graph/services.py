# SPDX-License-Identifier: Apache-2.0
"""Services by which a person acts on a run: gains held by hand (/hydro/override), frozen coefficients."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node
from rclpy.service import Service
from std_srvs.srv import SetBool

from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Level, Status
from hydro_bridge.ros.topics import FREEZE_SERVICE, OVERRIDE_SERVICE
from hydro_msgs.srv import OverrideGains
from hydro_policy.compensation.live import LiveCompensation
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


class FreezeService:
    """The service and the diagnostics of one estimator.

    `node`: node that runs the estimator. `compensation`: estimator that a request freezes or releases. `say`: called
    with a sentence for each change.
    """

    def __init__(self, node: Node, compensation: LiveCompensation, say: Callable[[str], None]) -> None:
        self._compensation, self._say = compensation, say
        node.create_service(SetBool, FREEZE_SERVICE, self._on_request)
        DiagnosticsPublisher(node, self._status, name="compensation")

    def _on_request(self, request: SetBool.Request, answer: SetBool.Response) -> SetBool.Response:
        self._compensation.frozen = bool(request.data)
        answer.success = True
        answer.message = "the coefficients are frozen" if request.data else "the coefficients adapt again"
        self._say(f"by /hydro/freeze_compensation: {answer.message}")
        return answer

    def _status(self) -> Status:
        health, frozen = self._compensation.health, self._compensation.frozen
        troubled = frozen or health["at a bound"] != "no"
        message = "frozen" if frozen else "adapts" if self._compensation.acting else "the paper's law acts"
        return Status(level=Level.WARN if troubled else Level.OK, message=message, values=health)
