# SPDX-License-Identifier: Apache-2.0
"""Units that loggers write, with factor and quantity."""

from __future__ import annotations

import re

_BY_QUANTITY: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3},
    "force": {"N": 1.0, "kN": 1e3, "daN": 10.0, "lbf": 4.4482216152605},
    "force rate": {"N/s": 1.0, "kN/s": 1e3},
    "pressure": {
        "Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5, "psi": 6894.757293168361,
        "N/mm2": 1e6,
    },
    "current": {"A": 1.0, "mA": 1e-3},
}  # fmt: skip

UNITS = {unit: factor for units in _BY_QUANTITY.values() for unit, factor in units.items()}
"""Factor from a unit to SI."""
QUANTITY = {unit: quantity for quantity, units in _BY_QUANTITY.items() for unit in units}
"""Quantity that a unit measures."""

_SPELLINGS = {
    "sec": "s", "second": "s", "seconds": "s", "sek": "s", "msec": "ms", "µs": "us", "μs": "us", "µm": "um", "μm": "um",
    "mikrometer": "um", "meter": "m", "metre": "m", "newton": "N", "pascal": "Pa", "ampere": "A", "amp": "A",
    "n": "N", "kn": "kN", "pa": "Pa", "kpa": "kPa", "mpa": "MPa", "a": "A", "ma": "mA",
    "n/mm²": "N/mm2", "n/mm^2": "N/mm2",
    "m*s^-1": "m/s", "m s-1": "m/s", "inch": "in",
}  # fmt: skip
_IN_NAME = re.compile(r"[\[(]\s*([^\])]{1,12})\s*[\])]\s*$")


def known(text: str) -> str:
    """The unit as `UNITS` spells it; empty where it is none of these."""
    bare = text.strip().strip("[](){}").strip()
    if bare in UNITS:
        return bare
    return _SPELLINGS.get(bare.lower(), bare.lower() if bare.lower() in UNITS else "")


def in_name(name: str) -> str:
    """The unit in brackets at the end of a column's name (`pos [mm]`), as `UNITS` spells it; empty if there is none."""
    found = _IN_NAME.search(name)
    return known(found[1]) if found else ""
