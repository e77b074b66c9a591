# SPDX-License-Identifier: Apache-2.0
"""Services by which a person acts on a run: gains held by hand (/hydro/override), frozen coefficients."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from rclpy.service import Service
from std_srvs.srv import SetBool

from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Level, Status
from hydro_bridge.ros.topics import FREEZE_SERVICE, OVERRIDE_SERVICE
from hydro_msgs.srv import OverrideGains
from hydro_policy.compensation.live import LiveCompensation

if TYPE_CHECKING:
    from hydro_policy.nodes.graph.node import GraphNode


class OverrideService:
    """The service of one node, whose override a request changes. `told`: called with the request and the answer."""

    def __init__(self, node: GraphNode, told: Callable[[str], None]) -> None:
        self._node, self._told = node, told
        self._service: Service | None = None

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
            self._node.warn(f"override refused: {error}")
        except OSError as error:  # the run's record cannot be written, which ends the run
            answer.success, answer.message = False, str(error)
            self._node.fail(error)
        refused = "" if answer.success else "refused: "
        self._told(f"{request.name or 'somebody'}: override, {_wanted(request)}: {refused}{answer.message}")
        return answer

    def _carry_out(self, request: OverrideGains.Request) -> str:
        """Execute a request and return a sentence about it; raises ValueError, OSError."""
        own = self._node.get_name()
        if request.whom not in ("", own):
            raise ValueError(f"{own} chooses the gains here, not {request.whom}")
        if not request.active:
            return self._node.override.release()
        gains = (request.proportional_gain, request.integral_gain)
        return self._node.override.hold(*gains, request.seconds, self._node.now())


def _wanted(request: OverrideGains.Request) -> str:
    if not request.active:
        return "give the gains back"
    return f"hold ({request.proportional_gain:g}, {request.integral_gain:g}) for {request.seconds:g} s"


class FreezeService:
    """The service and the diagnostics of the estimator of one node, which a request freezes or releases."""

    def __init__(self, node: GraphNode, compensation: LiveCompensation) -> None:
        self._node, self._compensation = node, compensation
        node.create_service(SetBool, FREEZE_SERVICE, self._on_request)
        DiagnosticsPublisher(node, self._status, name="compensation")

    def _on_request(self, request: SetBool.Request, answer: SetBool.Response) -> SetBool.Response:
        self._compensation.frozen = bool(request.data)
        answer.success = True
        answer.message = "the coefficients are frozen" if request.data else "the coefficients adapt again"
        self._node.warn(f"by /hydro/freeze_compensation: {answer.message}")
        return answer

    def _status(self) -> Status:
        health, frozen = self._compensation.health, self._compensation.frozen
        troubled = frozen or health["at a bound"] != "no"
        message = "frozen" if frozen else "adapts" if self._compensation.acting else "the paper's law acts"
        return Status(level=Level.WARN if troubled else Level.OK, message=message, values=health)
