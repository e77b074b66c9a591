# SPDX-License-Identifier: Apache-2.0
"""Service /hydro/freeze_compensation, by which a person holds the coefficients of the compensated law."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from std_srvs.srv import SetBool

from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Level, Status
from hydro_bridge.ros.topics import FREEZE_SERVICE
from hydro_policy.compensation.live import LiveCompensation


class FreezeService:
    """The service and the diagnostics of one estimator.

    Parameters
    ----------
    node
        Node that runs the estimator.
    compensation
        Estimator that a request freezes or releases.
    say
        Called with a sentence for each change.
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
