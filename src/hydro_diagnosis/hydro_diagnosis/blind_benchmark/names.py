# SPDX-License-Identifier: Apache-2.0
"""Correct names of the concealed causes: several where different sets of causes give exactly the same bench.

A spring's rest position shifts the force on the mass and, by the same amount in the opposite direction, the reading of
its load cell: any two of `force_offset`, `spring_rest` and a bias of the load cell make every bench that all three do.
A dead band around a shifted null is an asymmetric one around the old null. LuGre friction is friction with bristles.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any

Name = tuple[str, str]
"""Id, and the chamber, cell or sensor if it has one."""
PLACES = ("chamber", "cell", "sensor")
_CONSTANT = (("force_offset", ""), ("spring_rest", ""), ("load_cell_bias", "load_force"))
_BAND, _NULL = ("valve_deadband", ""), ("valve_offset", "")


def names(effects: Mapping[str, Mapping[str, Any]]) -> list[frozenset[Name]]:
    """All sets of causes that are equivalent to these effects, the given set first."""
    own = frozenset((cause, next((str(values[key]) for key in PLACES if key in values), ""))
                    for cause, values in effects.items())  # fmt: skip
    ways = [own]
    if len(own & set(_CONSTANT)) >= 2:
        ways += [own - set(_CONSTANT) | set(two) for two in combinations(_CONSTANT, 2)]
    if {_BAND, _NULL} <= own:
        ways += [way - {_NULL} for way in ways]
    if "half_width_negative" in effects.get("valve_deadband", ()):
        ways += [way | {_NULL} for way in ways]
    if effects.get("friction_coulomb", {}).get("form") == "lugre":
        ways += [way | {("friction_presliding", "")} for way in ways]
    return ways
