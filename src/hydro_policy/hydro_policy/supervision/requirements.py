# SPDX-License-Identifier: Apache-2.0
"""Requirements of a session before arming: a plant, the filter's corrections, a ready learner."""

from __future__ import annotations

from collections.abc import Callable

from hydro_bridge.safety.readiness import Requirement
from hydro_policy.supervision.learner_requests import ActingLearner

COMPILES = "it loads for some seconds; where `make setup` was not run after a change it compiles, up to a minute"
HOW_TO_GET_A_PLANT = "no samples on /hydro/state yet: start a plant, or use --plant sim, emulator or bench"
NO_FILTER = "the filter does not answer: base gains are in force unless the plant's guard does not require it"


def plant(ready: Callable[[], bool]) -> Requirement:
    """Samples arrive."""
    missing = "no samples on /hydro/state for 600 s: there is nothing to act on"
    return Requirement(name="the plant", ready=ready, hint=HOW_TO_GET_A_PLANT, within=600.0, missing=missing)


def corrections(ready: Callable[[], bool]) -> Requirement:
    """The filter's corrections reach the plant; without them it continues at base gains."""
    return Requirement(name="the filter", ready=ready, hint=COMPILES, within=45.0, missing=NO_FILTER, essential=False)


def fitting_filter(ready: Callable[[], bool]) -> Requirement:
    """The filter's model fits this bench, by the filter's own monitor of its predictions."""
    hint = "its model is not this bench's: start it with model and metric of this bench, or with --metric constant"
    missing = f"the filter says MISMATCH for 300 s: {hint}"
    return Requirement(name="a filter that fits", ready=ready, hint=hint, within=300.0, missing=missing)


def learner(learning: ActingLearner) -> Requirement:
    """The learner has published weights and is compiled."""
    missing = "the learner is not ready after 300 s: nothing would learn, and nothing was armed for it"
    return Requirement(name="the learner", ready=lambda: learning.ready, hint=COMPILES, within=300.0, missing=missing)
