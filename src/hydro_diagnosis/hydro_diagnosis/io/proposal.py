# SPDX-License-Identifier: Apache-2.0
"""A column map proposed from the columns' names, units and ranges; a person confirms it.

A column scores for words of its name that stand for a field, for a unit of the field's quantity, and for numbers of the
bench's size. The best pairs are taken one by one; what scores too little stays unmapped.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml

from hydro_bridge.signals import STATE_FIELDS, FloatArray
from hydro_diagnosis.formats.file_columns import Columns, named_like_time, runs_forward
from hydro_diagnosis.formats.units import QUANTITY, UNITS, in_name
from hydro_diagnosis.io.column_map import TARGETS, ColumnMap
from hydro_diagnosis.io.column_source import Source
from hydro_sim.model.bench import Bench

ENOUGH = 3.0
"""Score from which a column is proposed for a field: a word or a letter, and a unit or a range that agrees."""
_QUANTITY_OF = {
    "hydraulic_force": "force", "load_force": "force", "pressure_a": "pressure", "pressure_b": "pressure",
    "piston_position": "length", "piston_velocity": "velocity", "valve_current": "current", "reference_force": "force",
    "hydraulic_force_rate": "force rate", "load_force_rate": "force rate", "nominal_valve_current": "current",
}  # fmt: skip
_WORDS: Mapping[str, str] = {
    "hydraulic_force": r"hydraulic.?force|f_?h(yd\w*)?|zylinderkraft|kolbenkraft|(piston|actuator)_?force|f_?cyl\w*",
    "load_force": r"load_?(cell|force)?|f_?l(oad)?|kraft|last|lastkraft|force|kraftmess\w*",
    "pressure_a": r"p_?a|p_?1|pressure_?(a|1)|druck_?(a|1)|press_?a|a_?side|kammer_?a|chamber_?a",
    "pressure_b": r"p_?b|p_?2|pressure_?(b|2)|druck_?(b|2)|press_?b|b_?side|kammer_?b|chamber_?b",
    "piston_position": r"x|x_?p|s|pos\w*|position|piston_?pos\w*|weg|hub|stroke|displacement|lvdt|encoder|q",
    "piston_velocity": r"v|x_?dot|dx|vel\w*|velocity|speed|geschwindigkeit|piston_?vel\w*|qd",
    "valve_current": r"i|u|i_?v|u_?v|cur\w*|current|valve\w*|strom|ventil\w*|servo\w*|spool_?cmd",
    "reference_force": r"ref\w*|f_?ref|setpoint|soll\w*|force_?ref\w*|desired",
}
"""Names of columns, or words in them, that stand for a field."""
_LIKELY = {"pressure": ("bar", "kPa", "MPa"), "length": ("mm",), "current": ("mA",), "force": ("kN",)}
"""Units that are tried where none is stated."""
_NEVER = re.compile(r"temp|volt(age)?|flag|count(er)?|index|status|error|time", re.IGNORECASE)


def proposed(found: Columns, bench: Bench) -> ColumnMap:
    """Propose a source for each field; unknown fields are left out, as is the time where clocks are stated."""
    sources: dict[str, Source] = {}
    if not found.clocks:
        times = [name for name, values in found.series.items() if named_like_time(name) and runs_forward(values)]
        if times:
            best = "time" if "time" in times else times[0]
            sources["time"] = Source(best, unit=_time_unit(best, found))
    taken = set(found.clocks.values()) | {source.column for source in sources.values()}
    pairs = [
        (_score(field, name, found, bench), field, name)
        for field in _WORDS
        for name in found.series
        if name not in taken
    ]
    exact = [(100.0, name, name) for name in STATE_FIELDS if name in found.series]
    for score, field, name in sorted([*exact, *pairs], key=lambda pair: -pair[0]):
        if score >= ENOUGH and field not in sources and name not in taken:
            taken.add(name)
            sources[field] = Source(name, unit=_unit(field, name, found, bench))
    return ColumnMap({field: sources[field] for field in TARGETS if field in sources})


def as_yaml(columns: ColumnMap) -> str:
    """The map as a YAML file for `--columns`."""
    words: dict[str, Any] = {}
    for field, source in columns.sources.items():
        words[field] = {"column": source.column, "unit": source.unit} if source.unit else {"column": source.column}
    return str(yaml.safe_dump(words, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120))


def _score(field: str, name: str, found: Columns, bench: Bench) -> float:
    """Score of a column for a field."""
    own = _own_name(name)
    if _NEVER.search(own):
        return 0.0
    score = 0.0
    pattern = re.compile(_WORDS[field], re.IGNORECASE)
    if pattern.fullmatch(own):
        score += 2.5
    elif any(pattern.fullmatch(word) for word in re.split(r"[_\W]+", own) if word):
        score += 2.0
    unit = found.units.get(name) or in_name(name)
    if unit:
        score += 1.5 if QUANTITY[unit] == _QUANTITY_OF[field] else -3.0
    scale = UNITS.get(_unit(field, name, found, bench), 1.0)
    return score + (1.0 if _fits(field, scale * found.series[name], bench) else -0.5)


def _own_name(name: str) -> str:
    """The last part of a path: `Model Root/Sensors/pA/Out1` is pA, `/cylinder/pressure_a.data` is pressure_a."""
    bare = re.sub(r"[\[(][^\])]*[\])]\s*$", "", name).strip()
    parts = [part for part in re.split(r"[/\\.]", bare) if part]
    telling = [
        part for part in parts if not re.fullmatch(r"(out|in|value|data|samples|fluid_pressure)?\d*", part, re.I)
    ]
    return (telling or parts or [name])[-1]


def _unit(field: str, name: str, found: Columns, bench: Bench) -> str:
    """The unit that is stated, or the one in which the numbers are of the bench's size; empty for SI."""
    quantity = _QUANTITY_OF[field]
    unit = found.units.get(name) or in_name(name)
    if unit:
        return unit if QUANTITY[unit] == quantity and UNITS[unit] != 1.0 else ""
    candidates = ["", *_LIKELY.get(quantity, ())]
    fitting = [one for one in candidates if _fits(field, UNITS.get(one, 1.0) * found.series[name], bench)]
    return fitting[0] if fitting else ""


def _fits(field: str, values: FloatArray, bench: Bench) -> bool:
    """Return whether numbers in SI units are of the size that the field has on the bench."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return False
    low, high = float(finite.min()), float(finite.max())
    strength = bench.piston_area * bench.supply_pressure
    return {
        "pressure": -0.02 * bench.supply_pressure < low and 0.05 < high / bench.supply_pressure < 1.5,
        "length": -bench.stroke <= low and 1e-3 * bench.stroke < max(high, -low) <= 1.1 * bench.stroke,
        "current": 1e-3 < max(high, -low) / bench.valve_current_max <= 1.05,
        "force": 1e-3 * strength < max(high, -low) < 2.0 * strength,
        "velocity": max(high, -low) < 20.0 * bench.stroke,
    }.get(_QUANTITY_OF[field], False)


def _time_unit(name: str, found: Columns) -> str:
    unit = found.units.get(name) or in_name(name)
    if unit:
        return unit if QUANTITY[unit] == "time" and UNITS[unit] != 1.0 else ""
    return ""
