# SPDX-License-Identifier: Apache-2.0
"""Interface of the engines that compute loss and gradient (implementations: `identification.engines`)."""

from __future__ import annotations

from typing import Any, Protocol

from hydro_bridge.signals import FloatArray


class Engine(Protocol):
    """Shapes as in `network.loss_and_gradient` and `structured.loss_and_gradients`."""

    def network(
        self, layers: Any, step: Any, starts: Any, currents: Any, targets: Any, printed: bool
    ) -> tuple[float, FloatArray]:
        """Return loss and gradient by the flat weights of the paper's network."""

    def structured(
        self, c: Any, layers: Any, center: Any, scale: Any, starts: Any, currents: Any, targets: Any, weights: Any
    ) -> tuple[float, FloatArray, FloatArray]:
        """Return loss and gradients by the constants and by the flat network of the structured model."""
