# SPDX-License-Identifier: Apache-2.0
"""Proposal of a column map from the columns' names and units, to be confirmed by the user.

A column scores for words of its name that denote a field and for a unit of the field's quantity; pairs are assigned
greedily by score. Where no unit is stated, the one is proposed in which the values are plausible for the bench.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import yaml

from hydro_core.signals import STATE_FIELDS, FloatArray
from hydro_diagnosis.bench_parameters import has_spring
from hydro_diagnosis.io.column_map import QUANTITY_OF, TARGETS, ColumnMap, Source
from hydro_diagnosis.io.columns import Columns, is_time, runs_forward
from hydro_diagnosis.io.table import base_clock
from hydro_diagnosis.io.units import quantity, split_unit, to_si
from hydro_diagnosis.recording import MEASURED_CHANNELS
from hydro_diagnosis.wiring import MIN_CORRELATION
from hydro_sim.model.bench import Bench

_PRESSURE_PATTERN = r"(p|press\w*|druck\w*)"
_FIELD_PATTERNS: Mapping[str, str] = {
    "hydraulic_force": r"hydraulic_?force|f_?h(yd\w*)?|zylinderkraft|kolbenkraft|(piston|actuator)_?force|f_?cyl\w*|"
    r"f_?piston",
    "load_force": r"load_?(cell|force)?|f_?l(oad)?|kraft(mess\w*|aufn\w*|sensor)|last|lastkraft|f_?mess|f_?spring|"
    r"federkraft|kraft|force|f",
    "pressure_a": rf"{_PRESSURE_PATTERN}_?(a|1)|(a_?side|bore_?side|cap_?(side|end)|kolbenseit\w*|kammer_?a|"
    rf"chamber_?a)(_?{_PRESSURE_PATTERN})?",
    "pressure_b": rf"{_PRESSURE_PATTERN}_?(b|2)|(b_?side|rod_?(side|end)|ringseit\w*|stangenseit\w*|kammer_?b|"
    rf"chamber_?b)(_?{_PRESSURE_PATTERN})?",
    "piston_position": r"x|y|x_?p|s|pos\w*|piston_?pos\w*|\w*weg(aufn\w*|sensor)?|\w*hub|(\w*_)?stroke|displacement|"
    r"lvdt|encoder|q",
    "piston_velocity": r"v|x_?dot|dx|vel\w*|speed|\w*geschwindigkeit|piston_?vel\w*|qd",
    "valve_current": r"i|u|i_?v|u_?v|cur\w*|(servo_?)?valve\w*|\w*strom|ventil\w*|servo\w*|spool_?cmd",
    "reference_force": r"(\w*_)?(ref\w*|set_?point|soll\w*|desired)|soll\w*|"
    r"(f|force|kraft)_?(ref|set|des|soll|cmd|command)\w*",
}
"""Column names, or words in them, that denote a field."""
_FORCE_PATTERN = re.compile(r"kraft|force|f", re.IGNORECASE)
"""Words for a force that do not distinguish between several."""
_FORCE_PART_PATTERNS = {
    "hydraulic_force": re.compile(r"zylinder|kolben|cyl(inder)?|piston|actuator|hyd\w*", re.IGNORECASE),
    "load_force": re.compile(r"feder|spring|last|load|probe|specimen", re.IGNORECASE),
}
"""Words that distinguish the two forces."""
_LIKELY_UNITS = {"pressure": ("bar", "kPa", "MPa"), "length": ("mm",), "current": ("mA",), "force": ("kN",)}
"""Units tried for a quantity if none is stated."""
_REFERENCE_PATTERN = re.compile(
    _FIELD_PATTERNS["reference_force"] + r"|\w*(ref|soll|target|desired|setpoint)", re.IGNORECASE
)
_VALVE_PATTERN = re.compile(r"valve|spool|ventil|schieber|servo", re.IGNORECASE)
_EXCLUDED_PATTERN = re.compile(
    r"friction|reib|temp|volt(age)?|flag|count(er)?|index|status|error|time|integr|"
    r"(?<![a-z])(u_?[pid]|[pid]_?(part|term|anteil|gain)|k_?[pid]|term|anteil|gain)(?![a-z])",  # parts of a controller
    re.IGNORECASE,
)


def propose_sources(found: Columns, bench: Bench) -> ColumnMap:
    """Propose a column map; unrecognised fields are omitted, as is the time if the clocks state their units.

    Unknown parameters of the bench are replaced by the nominal bench's.
    """
    known, sprung = bench.to_mapping(), has_spring(bench)
    sizes = ("piston_area", "supply_pressure", "stroke", "valve_current_max")
    bench = replace(Bench.nominal(), **{name: known[name] for name in sizes if name in known})
    sources: dict[str, Source] = {}
    if not found.clocks:
        named = [name for name, values in found.series.items() if is_time(name, values)]
        first = next(iter(found.series))
        best = "time" if "time" in named else named[0] if named else first if runs_forward(found.series[first]) else ""
        if best:
            sources["time"] = Source(best, unit=_time_unit(best, found))
    taken = set(found.clocks.values()) | {source.column for source in sources.values()}
    free = {name: _words(_own_name(name)) for name in found.series if name not in taken}
    forces = [name for name in free if _is_force(name, free[name], found) and not _excluded(free[name])]
    pairs = [
        (_score(field, name, words, found, bench, len(forces)), field, name)
        for name, words in free.items()
        for field in _FIELD_PATTERNS
        if not _EXCLUDED_PATTERN.search("_".join(words))
    ]
    exact = [(100.0, name, name) for name in STATE_FIELDS if name in found.series]
    for score, field, name in sorted([*exact, *pairs], key=lambda pair: -pair[0]):
        # from a word or letter of the name, and a consistent unit or range
        if score >= 3.0 and field not in sources and name not in taken:
            taken.add(name)
            sources[field] = Source(name, unit=_unit(field, name, found, bench))
    left = [name for name in free if name not in taken]
    for field in ("piston_position", "valve_current", "load_force"):  # the only column in a unit of its quantity
        only = [name for name in left if found.unit(name) and quantity(found.unit(name)) == QUANTITY_OF[field]]
        if len(only) == 1 and field not in sources and not _EXCLUDED_PATTERN.search(_own_name(only[0])):
            sources[field] = Source(only[0], unit=_unit(field, only[0], found, bench))
    if len(forces) < 2 and "load_force" in sources and "hydraulic_force" not in sources:
        words = free[sources["load_force"].column]  # `load` alone is any force
        cell = any(re.search("feder|spring|probe|specimen|cell|mess|sensor", word, re.IGNORECASE) for word in words)
        place = found.series.get(sources["piston_position"].column if "piston_position" in sources else "")
        if not (sprung and (cell or place is None or _rises(found.series[sources["load_force"].column], place))):
            sources["hydraulic_force"] = sources.pop("load_force")
    if found.clocks and sources:
        clock = base_clock(sources, found)
        if clock not in found.units and (unit := _time_unit(clock, found)):
            sources["time"] = Source(clock, unit=unit)
    return ColumnMap({field: sources[field] for field in TARGETS if field in sources})


def _rises(force: FloatArray, place: FloatArray) -> bool:
    """Return whether a force goes with the position, as a spring's does."""
    both = np.isfinite(force) & np.isfinite(place) if len(force) == len(place) else np.zeros(1, dtype=bool)
    return not both.any() or float(np.corrcoef(force[both], place[both])[0, 1]) > MIN_CORRELATION


def _excluded(words: Sequence[str]) -> bool:
    return bool(_EXCLUDED_PATTERN.search("_".join(words))) or any(map(_REFERENCE_PATTERN.fullmatch, words))


def as_yaml(columns: ColumnMap) -> str:
    """Column map as the text of a YAML file for `--columns`."""
    words: dict[str, Any] = {}
    for field, source in columns.sources.items():
        entry = {"column": source.column, "unit": source.unit} if source.unit else {"column": source.column}
        words[field] = entry if replace(source, unit="").plain and not source.delay else str(source)
    return str(yaml.safe_dump(words, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120))


def _score(field: str, name: str, words: Sequence[str], found: Columns, bench: Bench, n_forces: int) -> float:
    """Score of a column for a field."""
    reference = any(map(_REFERENCE_PATTERN.fullmatch, words))
    measured = field in (*MEASURED_CHANNELS, "piston_velocity")
    if reference and (measured or (field == "reference_force" and _moves(words))):
        return 0.0
    score, own = 0.0, re.sub(r"\W+", "_", _own_name(name))
    if field in _FORCE_PART_PATTERNS and _is_force(name, words, found):
        words = [word for word in words if not _FORCE_PATTERN.fullmatch(word)] if n_forces > 1 else words
        own = "_".join(word for word in own.split("_") if word in words)
        score += 3.5 * any(_FORCE_PART_PATTERNS[field].fullmatch(word) for word in words)
    if score == 0.0 and own:
        pattern = re.compile(_FIELD_PATTERNS[field], re.IGNORECASE)
        said = [word for word in words if pattern.fullmatch(word)]
        plainly = (
            field in MEASURED_CHANNELS
            and any(len(word) > 3 and not _FORCE_PATTERN.fullmatch(word) for word in said)
            and not any(map(_VALVE_PATTERN.fullmatch, words))
        )
        score += 3.5 if plainly else 2.5 if pattern.fullmatch(own) else 2.0 if said else 0.0
    if score == 0.0:
        return 0.0
    unit = found.unit(name)
    if unit:
        score += 1.5 if quantity(unit) == QUANTITY_OF[field] else -3.0
    values = found.series[name]
    peak = float(np.nanmax(np.abs(values), initial=0.0))
    relative = field == "valve_current" and not unit and 1e-2 < peak < 105.0  # a command of 1, 10 V or 100 %
    plausible = relative or _fits(field, to_si(_unit(field, name, found, bench)) * values, bench)
    return score + (1.0 if plausible else -0.5)


def _moves(words: Sequence[str]) -> bool:
    """Return whether a word denotes a motion."""
    fields = ("piston_position", "piston_velocity")
    return any(re.fullmatch(_FIELD_PATTERNS[field], word, re.IGNORECASE) for field in fields for word in words)


def _is_force(name: str, words: Sequence[str], found: Columns) -> bool:
    unit = found.unit(name)
    return quantity(unit) == "force" if unit else any(map(_FORCE_PATTERN.fullmatch, words))


def _words(name: str) -> list[str]:
    """Words of a name: `F_load_cell` by its underscores, `JibPaCyl` by its capitals."""
    words = [word for word in re.split(r"[\W_]+", name) if word]
    capitals = [part for word in words for part in re.findall(r"[A-Z]+[a-z]*\d*|[a-z]+\d*", word)]
    pairs = [f"{one}_{other}" for some in (words, capitals) for one, other in pairwise(some)]
    return [*dict.fromkeys([*words, *(capitals if len(name) > 3 else ()), *pairs])]


def _own_name(name: str) -> str:
    r"""Last informative part of a path: pA of `Model Root/pA/Out1` and `pA\ADC:1`, pressure_a of `/pressure_a.data`."""
    parts = [part for part in re.split(r"[/\\.]", split_unit(name)[0]) if part]
    telling = [
        part for part in parts if not re.fullmatch(r"(out|in|value|data|samples|fluid_pressure)?\d*|.*:\d+", part, re.I)
    ]
    return (telling or parts or [name])[-1]


def _unit(field: str, name: str, found: Columns, bench: Bench) -> str:
    """Unit of a column: stated, or the one in which the values are plausible for the field; empty for SI."""
    wanted, unit = QUANTITY_OF.get(field, ""), found.unit(name)
    if name in found.unsure:
        return ""
    if unit or name == field:
        return unit if quantity(unit) == wanted and to_si(unit) != 1.0 else ""
    candidates = ["", *_LIKELY_UNITS.get(wanted, ())]
    fitting = [one for one in candidates if _fits(field, to_si(one) * found.series[name], bench)]
    return fitting[0] if fitting else ""


def _fits(field: str, values: FloatArray, bench: Bench) -> bool:
    """Return whether values in SI units are of a plausible magnitude for the field on the bench."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return False
    low, high = float(finite.min()), float(finite.max())
    strength = bench.piston_area * bench.supply_pressure
    return {
        "pressure": -0.02 * bench.supply_pressure < low and 0.05 < high / bench.supply_pressure < 1.5,
        "length": -bench.stroke <= low and 1e-2 * bench.stroke < max(high, -low) <= 1.1 * bench.stroke,
        "current": 1e-2 < max(high, -low) / bench.valve_current_max <= 1.05,
        "force": 1e-3 * strength < max(high, -low) < 2.0 * strength,
        "velocity": max(high, -low) < 20.0 * bench.stroke,
    }.get(QUANTITY_OF.get(field, ""), False)


def _time_unit(name: str, found: Columns) -> str:
    """Unit of a time column: stated, or the one that gives 10 rows a second or more; empty for seconds."""
    if unit := found.unit(name):
        return unit if quantity(unit) == "time" and to_si(unit) != 1.0 else ""
    step = float(np.nanmean(np.diff(found.series[name])))
    return next((unit for unit in ("", "ms", "us") if step * to_si(unit) <= 0.1), "ns")
