# SPDX-License-Identifier: Apache-2.0
"""Topics and services that each executable uses: the single table behind policies and keys.

A graph test compares the running nodes with it, endpoint by endpoint (tests/test_graph_rights.py): a topic added to a
node is added here as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hydro_bridge.ros.topics import (
    ARM_SERVICE,
    AUTHORITY,
    BOX,
    BOX_LAW,
    CLAIM_SERVICE,
    CLOCK,
    COMMANDS,
    CORRECTION,
    DIAGNOSTICS,
    END_SERVICE,
    FREEZE_SERVICE,
    GAINS,
    GRAPH,
    LAW,
    LAW_STATE,
    LOG,
    OVERRIDE_SERVICE,
    POLICY,
    REFERENCE,
    STATE,
    TRAINING,
)

PARAMETER_EVENTS = "/parameter_events"
DESCRIPTION_SERVICE = "get_type_description"
PARAMETER_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
"""Parameter services of each node, below its name. No node may call them, since our parameters are read-only."""


@dataclass(frozen=True, kw_only=True)
class Rights:
    """Topics and services of a node; each name begins with a slash."""

    publishes: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()
    """Services it offers."""
    calls: tuple[str, ...] = ()
    """Services it calls."""


def enclave_of(executable: str) -> str:
    """Return the name of an executable's enclave."""
    return f"/hydro/{executable}"


def node(name: str, rights: Rights) -> Rights:
    """Return the rights extended by those that rclpy needs for any ordinary node of that name."""
    return Rights(
        publishes=(*rights.publishes, LOG, PARAMETER_EVENTS),
        subscribes=rights.subscribes,
        answers=(*rights.answers, *(f"/{name}/{service}" for service in (*PARAMETER_SERVICES, DESCRIPTION_SERVICE))),
        calls=rights.calls,
    )


_ARMING = (ARM_SERVICE, CLAIM_SERVICE)
"""Services of a plant. Our own programs call the second, under their names; the first is open to all."""
_PLANT = Rights(
    publishes=(STATE, LAW_STATE, BOX, BOX_LAW, AUTHORITY, DIAGNOSTICS), subscribes=COMMANDS, answers=_ARMING
)

RIGHTS: Mapping[str, Mapping[str, Rights]] = {
    "bridge": {"bridge": node("bridge", _PLANT)},
    "sim": {
        "sim": node(
            "sim",
            Rights(publishes=(*_PLANT.publishes, CLOCK), subscribes=_PLANT.subscribes, answers=_PLANT.answers),
        ),
    },
    "replayer": {
        "replayer": node("replayer", Rights(publishes=(STATE, LAW_STATE, BOX, BOX_LAW, DIAGNOSTICS), answers=_ARMING))
    },
    "filter": {
        "filter": node(
            "filter", Rights(publishes=(CORRECTION, DIAGNOSTICS), subscribes=(STATE, LAW_STATE, BOX, AUTHORITY, CLOCK))
        ),
    },
    "trainer": {
        "trainer": node(
            "trainer",
            Rights(
                publishes=(GAINS, LAW, REFERENCE, TRAINING, POLICY, DIAGNOSTICS),
                subscribes=(STATE, LAW_STATE, BOX, BOX_LAW, AUTHORITY, CORRECTION, DIAGNOSTICS),
                answers=(OVERRIDE_SERVICE, FREEZE_SERVICE, END_SERVICE),
                calls=(CLAIM_SERVICE,),
            ),
        ),
    },
    "evaluate": {
        "evaluate": node(
            "evaluate",
            Rights(
                publishes=(GAINS, LAW, REFERENCE, DIAGNOSTICS),
                subscribes=(STATE, LAW_STATE, BOX, BOX_LAW, AUTHORITY, DIAGNOSTICS),
                answers=(OVERRIDE_SERVICE, FREEZE_SERVICE, END_SERVICE),
                calls=(CLAIM_SERVICE,),
            ),
        ),
    },
    "collect": {
        "collect": node(
            "collect",
            Rights(
                publishes=(GAINS, REFERENCE),
                subscribes=(STATE, BOX, AUTHORITY, DIAGNOSTICS),
                answers=(END_SERVICE,),
                calls=(CLAIM_SERVICE,),
            ),
        ),
    },
    "recorder": {"recorder": node("recorder", Rights(publishes=(DIAGNOSTICS,), subscribes=tuple(GRAPH)))},
    "dashboard": {
        "dashboard": node(
            "dashboard",
            Rights(
                publishes=(DIAGNOSTICS,),
                subscribes=(BOX, AUTHORITY, TRAINING, DIAGNOSTICS),
                calls=(CLAIM_SERVICE, OVERRIDE_SERVICE, FREEZE_SERVICE, END_SERVICE),
            ),
        ),
        "dashboard_samples": Rights(publishes=(PARAMETER_EVENTS,), subscribes=(STATE, LAW_STATE, CORRECTION)),
    },
    "arm": {"arm": node("arm", Rights(calls=(CLAIM_SERVICE,)))},
    "override": {"override": node("override", Rights(calls=(OVERRIDE_SERVICE,)))},
    "watch": {"_ros2cli_*": node("_ros2cli_*", Rights(subscribes=(*GRAPH, CLOCK)))},
}
"""Rights by executable and node. `watch` is not one of our executables but a user's read-only `ros2 topic echo`."""
