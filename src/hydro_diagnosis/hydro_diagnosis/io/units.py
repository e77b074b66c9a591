# SPDX-License-Identifier: Apache-2.0
"""Units of columns, by pint and by spellings of loggers, and units within the names of columns."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

OFFERED_UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "d": 86400.0},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3},
    "force": {"N": 1.0, "kN": 1e3, "daN": 10.0, "lbf": 4.4482216152605, "kip": 4448.2216152605},
    "force rate": {"N/s": 1.0, "kN/s": 1e3},
    "pressure": {"Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5, "psi": 6894.757293168361,
                 "N/mm2": 1e6},
    "current": {"A": 1.0, "mA": 1e-3},
}  # fmt: skip
UNIT_FACTORS = {unit: one for units in OFFERED_UNITS.values() for unit, one in units.items()}
"""Factor to SI of the units that are offered for a field; pint, which takes a second to load, reads all others."""
_COMMON_UNITS = {unit: (quantity, one) for quantity, units in OFFERED_UNITS.items() for unit, one in units.items()}
_SI_UNITS = {
    "time": "s", "length": "m", "velocity": "m/s", "acceleration": "m/s**2", "force": "N", "force rate": "N/s",
    "pressure": "Pa", "current": "A", "voltage": "V", "temperature": "K", "flow": "m**3/s", "frequency": "1/s",
    "torque": "N*m", "mass": "kg", "power": "W", "ratio or angle": "rad",
}  # fmt: skip
_UNIT_SPELLINGS = {
    "sec": "s", "sek": "s", "sekunden": "s", "seconds": "s",
    "msek": "ms", "meter": "m", "mikrometer": "um", "n": "N", "kn": "kN", "pa": "Pa",
    "kpa": "kPa", "mpa": "MPa", "a": "A", "ma": "mA", "v": "V", "amp": "A", "amps": "A", "kp": "kgf", "lbs/in2": "psi",
    "psig": "psi", "barg": "bar", "bar(g)": "bar", "kg/cm2": "kgf/cm2", "kp/cm2": "kgf/cm2", "kg/cm²": "kgf/cm2",
    "kp/cm²": "kgf/cm2", "lpm": "l/min", "gpm": "gallon/min", "hz": "Hz", "khz": "kHz", "u/min": "rpm",
    "°c": "degC", "°C": "degC", "deg c": "degC", "celsius": "degC", "c": "degC", "°f": "degF", "f": "degF",
    "°": "deg", "grad": "deg",
    "Nm": "N*m", "kNm": "kN*m", "NM": "N*m",
}  # fmt: skip
"""Spellings of loggers in pint's; lower-case keys apply to any case."""
_NO_UNIT_TEXTS = ("", "-", "--", "1", "n/a", "na", "none", "unitless", "dimensionless", "no unit")
_UNIT_PATTERN = re.compile(r"(?:1/)?[A-Za-zµμΩ°%$/*·^(][\w µμΩ°%/*·^().²³⁻¹-]{0,23}")


@cache
def _registry() -> Any:
    """Separate unit registry: the program's own may define other units, and is filled late."""
    import pint

    return pint.UnitRegistry()


@cache
def _measured(text: str) -> tuple[str, float] | None:
    """Quantity of a unit and its factor to SI, or None where pint or the bench has none."""
    if text in _COMMON_UNITS:
        return _COMMON_UNITS[text]
    if not _UNIT_PATTERN.fullmatch(text):
        return None
    units, powers = _registry(), re.sub(r"(?<=[A-Za-z])(-?[1-4])(?![\w])", r"**\1", text)
    try:
        parsed = units.parse_units(powers)
        dimensions = parsed.dimensionality
        factor = units.get_base_units(parsed, check_nonmult=False)[0]
    except Exception:  # pint raises what its parser, tokenizer and registry raise
        return None
    quantity = next((q for q, one in _SI_UNITS.items() if units.parse_units(one).dimensionality == dimensions), "")
    return (quantity, float(f"{factor:.15g}")) if quantity else None


@cache
def known(text: str) -> str:
    """Return a unit in pint's spelling; empty if it measures no quantity of a bench. `mPa` is kept, `MPA` is MPa."""
    bare = text.strip().strip('[]{}"').strip().partition(" since ")[0]
    bare = bare[1:-1].strip() if bare[:1] == "(" and bare[-1:] == ")" else bare
    bare = bare.rstrip(".")
    lower = bare.lower()
    if lower in _NO_UNIT_TEXTS:
        return ""
    tried = (_UNIT_SPELLINGS.get(bare, ""), bare, _UNIT_SPELLINGS.get(lower, ""), lower)
    return next((one for one in tried if one and _measured(one)), "")


def stated(text: str) -> str:
    """Unit stated by a text: in pint's spelling if known, else the text itself; empty for none or dimensionless."""
    bare = text.strip().strip('[]"').strip()
    return known(text) or ("" if bare.lower() in _NO_UNIT_TEXTS else bare)


def quantity(unit: str) -> str:
    """Physical quantity measured by a unit; empty if the unit is unknown."""
    found = _measured(known(unit)) if unit else None
    return found[0] if found else ""


def to_si(unit: str) -> float:
    """Factor from a unit to SI; 1 for an empty unit. Raises KeyError if the unit is unknown."""
    if not unit:
        return 1.0
    found = _measured(known(unit))
    if found is None:
        raise KeyError(unit)
    return found[1]


_BRACKETED_UNIT = re.compile(r"\s*(?:\[\s*([^\]]{1,16})\s*\]|\(\s*([^)]{1,16})\s*\))\s*$")
_TRAILING_UNIT = re.compile(r"(?:\s+in\s+|\s*/\s*)([A-Za-zµ°%][\w°²]{0,6})$")
_UNIT_SUFFIX = re.compile(
    r"_(s|ms|us|ns|m|mm|cm|um|inch|ft|[mukM]?N|daN|lbf|lbs?|kip|kgf|kg|[hkM]?Pa|m?bar|psi|ksi|[mu]?A|m?V|m?rad|deg[CF]?|"
    r"k?Hz|rpm|lpm|l|k?Nm)(?:_(?:per_)?(s2|s|min|mm2|m2|cm2))?$"
)
_AMBIGUOUS = {
    "s": r"t|\w*time\w*|\w*zeit|\w*stamp|elapsed|clock", "A": r"i|i_?v\w*|\w*current|cur|\w*strom",
    "a": "", "b": "", "B": "",
    "V": r"u|\w*volt\w*|cmd\w*|command|control|signal|spannung", "m": r"[xyzsq]|pos\w*|\w*weg|stroke", "l": r"vol\w*",
}  # fmt: skip
"""Units that are more often a chamber or a port, with the words next to which they are units."""


def split_unit(name: str) -> tuple[str, str]:
    """A column's name without the unit at its end, and that unit: `pos [mm]`, `pos_mm`, `vel_mm_s`, `p / bar`.

    Text in square brackets is a unit even if unknown, text elsewhere only if known.
    """
    bracketed, trailing, suffix = (one.search(name) for one in (_BRACKETED_UNIT, _TRAILING_UNIT, _UNIT_SUFFIX))
    if (found := bracketed or trailing or suffix) is None:
        return name, ""
    own, text = name[: found.start()].strip(), found[1] or found[2]
    if bracketed and found[1]:
        return own or name, stated(text)
    if text in _AMBIGUOUS and not (found is suffix and found[2]):
        words = re.split(r"[\W_]+", own)
        text = text if any(re.fullmatch(_AMBIGUOUS[text], word, re.I) for word in words if word) else ""
    unit = known(f"{text}/{found[2]}" if found is suffix and found[2] else text)
    plain = found is not trailing or unit in (*UNIT_FACTORS, "V")
    return (own or name, unit) if unit and (own or bracketed) and plain else (name, "")
