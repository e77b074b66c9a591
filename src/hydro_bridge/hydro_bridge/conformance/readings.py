# SPDX-License-Identifier: Apache-2.0
"""Access to the received states for the checks, and their tolerances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isclose
from typing import Any

from hydro_bridge.conformance.host import Host
from hydro_bridge.serial.frames import BoxInfo
from hydro_bridge.serial.protocol import State
from hydro_bridge.signals import STATE_FIELDS

Bench = Mapping[str, Any] | None
"""Numbers of the bench file, if one was given."""


class NotToldError(Exception):
    """The box does not report a value that a check needs and that is optional: the case is skipped."""


SINGLE = 1e-6
"""Relative error of a float32, with room for one operation."""


def value(state: State, name: str) -> float:
    """Return a float field of a state by its name."""
    return state.values[STATE_FIELDS.index(name)]


def box_info(host: Host) -> BoxInfo:
    """Return the content of the box's HELLO."""
    assert host.hello is not None and host.hello.info is not None
    return host.hello.info


def followed(host: Host) -> str:
    """Return the field of the force that the box's law follows: as given in DETAILS, else the load force."""
    told = host.details.details.feedback if host.details else ""
    return f"{told or 'load'}_force"


def settled(host: Host) -> Sequence[State]:
    """Return the states from the one that confirms the step's first command on."""
    return host.states[host.confirmed(host.sent[host.marked_sent].sequence) :] if host.new_sent else host.new_states


def near(one: float, other: float) -> bool:
    """Return whether two numbers agree as float32."""
    return isclose(one, other, rel_tol=SINGLE, abs_tol=1e-12)
