# SPDX-License-Identifier: Apache-2.0
"""The topics and services that each executable uses: the one table behind policies and keys.

A graph test holds the running nodes to it, endpoint by endpoint (tests/test_graph_rights.py): whoever adds a topic to a
node adds it here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hydro_bridge.ros.topics import (
    ARM_SERVICE,
    AUTHORITY,
    BOX,
    CLAIM_SERVICE,
    CLOCK,
    COMMANDS,
    CORRECTION,
    DIAGNOSTICS,
    END_SERVICE,
    GAINS,
    GRAPH,
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
"""Of each node, behind its name. They answer; nobody has the right to ask, for our parameters are read-only."""


@dataclass(frozen=True, kw_only=True)
class Rights:
    """Topics and services of a node; each name begins with a slash."""

    publishes: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()
    """Services that it offers."""
    calls: tuple[str, ...] = ()
    """Services that it asks."""


def enclave_of(executable: str) -> str:
    """Name of an executable's enclave."""
    return f"/hydro/{executable}"


def node(name: str, rights: Rights) -> Rights:
    """The rights, extended by those that rclpy needs for every ordinary node of that name."""
    return Rights(
        publishes=(*rights.publishes, LOG, PARAMETER_EVENTS),
        subscribes=rights.subscribes,
        answers=(*rights.answers, *(f"/{name}/{service}" for service in (*PARAMETER_SERVICES, DESCRIPTION_SERVICE))),
        calls=rights.calls,
    )


_ARMING = (ARM_SERVICE, CLAIM_SERVICE)
"""What a plant answers. Our own programs ask by the second, with their names; the first is everybody's."""
_PLANT = Rights(publishes=(STATE, BOX, AUTHORITY, DIAGNOSTICS), subscribes=COMMANDS, answers=_ARMING)

RIGHTS: Mapping[str, Mapping[str, Rights]] = {
    "bridge": {"bridge": node("bridge", _PLANT)},
    "sim": {
        "sim": node(
            "sim",
            Rights(publishes=(*_PLANT.publishes, CLOCK), subscribes=_PLANT.subscribes, answers=_PLANT.answers),
        ),
    },
    "replayer": {"replayer": node("replayer", Rights(publishes=(STATE, BOX, DIAGNOSTICS), answers=_ARMING))},
    "filter": {
        "filter": node(
            "filter", Rights(publishes=(CORRECTION, DIAGNOSTICS), subscribes=(STATE, BOX, AUTHORITY, CLOCK))
        ),
    },
    "trainer": {
        "trainer": node(
            "trainer",
            Rights(
                publishes=(GAINS, REFERENCE, TRAINING, POLICY, DIAGNOSTICS),
                subscribes=(STATE, BOX, AUTHORITY, CORRECTION, DIAGNOSTICS),
                answers=(OVERRIDE_SERVICE, END_SERVICE),
                calls=(CLAIM_SERVICE,),
            ),
        ),
    },
    "evaluate": {
        "evaluate": node(
            "evaluate",
            Rights(
                publishes=(GAINS, REFERENCE),
                subscribes=(STATE, BOX, AUTHORITY, DIAGNOSTICS),
                answers=(OVERRIDE_SERVICE, END_SERVICE),
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
                calls=(CLAIM_SERVICE, OVERRIDE_SERVICE, END_SERVICE),
            ),
        ),
        "dashboard_samples": Rights(publishes=(PARAMETER_EVENTS,), subscribes=(STATE, CORRECTION)),
    },
    "arm": {"arm": node("arm", Rights(calls=(CLAIM_SERVICE,)))},
    "override": {"override": node("override", Rights(calls=(OVERRIDE_SERVICE,)))},
    "watch": {"_ros2cli_*": node("_ros2cli_*", Rights(subscribes=(*GRAPH, CLOCK)))},
}
"""By executable, and by its nodes. `watch` is no executable of ours but a person's `ros2 topic echo`: it only reads."""
