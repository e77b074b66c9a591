# SPDX-License-Identifier: Apache-2.0
"""Proposal of a column map from the columns' names, units and values, to be confirmed by the user.

A column scores for words of its name that denote a field, for a unit of the field's quantity, and for values of
plausible magnitude; pairs are assigned greedily by score. Columns with uninformative names are assigned by their units
and correlations: chamber A's pressure rises with the position, the hydraulic force is A_A p_A - A_B p_B. Without
informative names and units, only the bench's equations and parameters are used. Low scores stay unmapped.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import yaml

from hydro_core.signals import STATE_FIELDS, FloatArray
from hydro_diagnosis.bench_parameters import has_spring
from hydro_diagnosis.io.column_map import QUANTITY_OF, TARGETS, ColumnMap, Source
from hydro_diagnosis.io.columns import Columns, is_time, means, quantity, runs_forward, split_unit, to_si
from hydro_diagnosis.io.table import base_clock
from hydro_diagnosis.recording import MEASURED_CHANNELS
from hydro_diagnosis.significance import PRACTICAL_SHARE
from hydro_diagnosis.wiring import BLOCK_SAMPLES, INSPECTED_SAMPLES, MIN_CORRELATION, block_regression
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
    "reference_force": r"(\w*_)?(ref\w*|set_?point|soll\w*|desired)|(f|force)_?(ref|set|des)\w*|soll\w*",
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
_EXCLUDED_PATTERN = re.compile(r"friction|reib|temp|volt(age)?|flag|count(er)?|index|status|error|time", re.IGNORECASE)


def propose_sources(found: Columns, bench: Bench) -> ColumnMap:
    """Propose a column map; unrecognised fields are omitted, as is the time if the clocks state their units.

    Unknown parameters of the bench are replaced by the nominal bench's.
    """
    known, sprung = bench.to_mapping(), has_spring(bench)
    sizes = ("piston_area", "area_ratio", "supply_pressure", "stroke", "valve_current_max", "spring_stiffness")
    bench = replace(Bench.nominal(), **{name: known[name] for name in sizes if name in known})
    sources: dict[str, Source] = {}
    if not found.clocks:
        named = [name for name, values in found.series.items() if is_time(name, values)]
        even = [  # in equal steps, as times are
            name
            for name, values in found.series.items()
            if runs_forward(values) and len(values) > 2 and np.ptp(np.diff(values)) < 1e-3 * np.diff(values).mean()
        ]
        if named or even:
            best = "time" if "time" in named else (named or even)[0]
            sources["time"] = Source(best, unit=_time_unit(best, found))
    taken = set(found.clocks.values()) | {source.column for source in sources.values()}
    free = [name for name in found.series if name not in taken]
    pairs = [(_score(field, name, found, bench), field, name) for field in _FIELD_PATTERNS for name in free]
    exact = [(100.0, name, name) for name in STATE_FIELDS if name in found.series]
    for score, field, name in sorted([*exact, *pairs], key=lambda pair: -pair[0]):
        # from a word or letter of the name, and a consistent unit or range
        if score >= 3.0 and field not in sources and name not in taken:
            taken.add(name)
            sources[field] = Source(name, unit=_unit(field, name, found, bench))
    _add_by_physics(sources, found, bench)
    _move_lone_force(sources, found, sprung)
    if sources.keys() == {"time"}:
        _add_by_equations(sources, found, bench)
    if found.clocks and sources:
        clock = base_clock(sources, found)
        if clock not in found.units and (unit := _time_unit(clock, found)):
            sources["time"] = Source(clock, unit=unit)
    return ColumnMap({field: sources[field] for field in TARGETS if field in sources})


def _move_lone_force(sources: dict[str, Source], found: Columns, sprung: bool) -> None:
    """Assign a single force to the hydraulic force, unless it follows the position as a spring force does.

    Names that denote a load, spring or cell keep it the load force.
    """
    load, place = sources.get("load_force"), sources.get("piston_position")
    if load is None or place is None or "hydraulic_force" in sources or _forces(found) > 1:
        return
    words = _words(_own_name(load.column))
    if any(
        _FORCE_PART_PATTERNS["load_force"].fullmatch(word) or re.search("cell|mess|sensor", word, re.I)
        for word in words
    ):
        return
    force, position = found.series[load.column], found.series[place.column]
    both = np.isfinite(force) & np.isfinite(position) if len(force) == len(position) else np.zeros(len(force), bool)
    slope, left = block_regression(position[both], force[both], 1) if both[: len(position)].any() else (1.0, 0.0)
    if not sprung or slope < 0.0 or left > 1.0 - MIN_CORRELATION**2:
        sources["hydraulic_force"] = sources.pop("load_force")


def _add_by_physics(sources: dict[str, Source], found: Columns, bench: Bench) -> None:
    """Add columns with a stated unit but an uninformative name; several of one quantity by their correlations."""
    left: dict[str, list[str]] = {}
    taken = {source.column for source in sources.values()}
    for name, values in found.series.items():
        moves = name not in taken and np.isfinite(values).all() and np.ptp(values) > 0.0
        if moves and (unit := found.unit(name)) and not _EXCLUDED_PATTERN.search(_own_name(name)):
            left.setdefault(quantity(unit), []).append(name)

    def take(field: str, name: str | None) -> None:
        if name is not None and field not in sources:
            sources[field] = Source(name, unit=_unit(field, name, found, bench))
            left[QUANTITY_OF[field]].remove(name)

    def nearest(field: str, like: FloatArray) -> str | None:
        """Return the column with the highest correlation with `like`; None unless there are several."""
        names = left.get(QUANTITY_OF[field], [])
        return max(names, key=lambda name: _correlation(found.series[name], like)) if len(names) > 1 else None

    def only(field: str) -> str | None:
        names = left.get(QUANTITY_OF[field], [])
        return names[0] if len(names) == 1 else None

    for field in ("piston_position", "valve_current"):
        take(field, only(field))
    if "piston_position" in sources:  # an actuator that pushes a load against its spring
        take("pressure_a", nearest("pressure_a", found.series[sources["piston_position"].column]))
    take("pressure_a", only("pressure_a"))
    take("pressure_b", only("pressure_b"))
    forces = left.get("force", [])
    silent = [name for name in forces if _silent(found.series[name])]
    if len(silent) == 1 and len(forces) > 1:
        take("reference_force", silent[0])
    if {"pressure_a", "pressure_b"} <= sources.keys():
        a, b = (found.series[sources[field].column] for field in ("pressure_a", "pressure_b"))
        if len(a) == len(b):
            take("hydraulic_force", nearest("hydraulic_force", a - bench.area_ratio * b))
    take("load_force", only("load_force"))


def _add_by_equations(sources: dict[str, Source], found: Columns, bench: Bench) -> None:
    """Add columns with neither an informative name nor a unit, if they satisfy the bench's equations.

    A_A p_A - A_B p_B is the hydraulic force, all forces are about the spring's, a reference has no noise, and the
    velocity follows the current.
    """
    clock = sources["time"].column
    free = {
        name: values[:INSPECTED_SAMPLES]
        for name, values in found.series.items()
        if name != clock and len(values) == len(found.series[clock]) and np.isfinite(values).all()
        and np.ptp(values) > 0.0 and not (_EXCLUDED_PATTERN.search(name) or found.unit(name))
    }  # fmt: skip
    if len(free) > 16 or len(found.series[clock]) < 100 * BLOCK_SAMPLES:
        return

    def sized(field: str, taken: set[str]) -> dict[Source, FloatArray]:
        """Means over `BLOCK_SAMPLES` rows [SI] of columns, in each unit in which they are plausible for it."""
        units = ("", *_LIKELY_UNITS.get(QUANTITY_OF[field], ()))
        there = {Source(name, unit=unit): to_si(unit) * free[name] for name in free for unit in units}
        sizes = {source: means(one, BLOCK_SAMPLES) for source, one in there.items() if source.column not in taken}
        return {source: one for source, one in sizes.items() if _fits(field, one, bench)}

    def solved(force: Source, a: Source, b: Source) -> dict[str, Source]:
        """Return the sources of fields that are consistent with this force and these pressures."""
        taken, fields = {a.column, b.column}, {"pressure_a": a, "pressure_b": b}

        def take(field: str, fitting: Sequence[Source]) -> None:
            if len(fitting) == 1:
                fields[field] = fitting[0]
                taken.add(fitting[0].column)

        exact = _balance(forces[force], pressures[a], pressures[b], bench, PRACTICAL_SHARE) < 1e-3
        take("hydraulic_force", [force] if exact else [])
        places = sized("piston_position", taken | {force.column})
        springs = {place: block_regression(one, forces[force], 1) for place, one in places.items()}
        springs = {place: spring for place, spring in springs.items() if _like_spring(*spring, bench)}
        if not springs:
            return fields
        place = min(springs, key=lambda one: springs[one][1])
        take("piston_position", [place])
        slopes = {one: block_regression(places[place], values, 1) for one, values in sized("load_force", taken).items()}
        silent = [one for one in slopes if _silent(free[one.column])]
        take("load_force", [one for one in slopes if one not in silent and _like_spring(*slopes[one], bench)])
        take("reference_force", [one for one in silent if _like_spring(*slopes[one], bench, 0.5)])  # a force lags it
        speed = np.diff(places[place])
        currents = {one: abs(_correlation(values[1:], speed)) for one, values in sized("valve_current", taken).items()}
        best = max(currents.values(), default=0.0)
        take("valve_current", [one for one, alike in currents.items() if alike > 0.5 and alike == best])
        return fields

    forces, pressures = sized("load_force", set()), sized("pressure_a", set())
    triples = {
        (force, a, b): _balance(forces[force], pressures[a], pressures[b], bench)
        for a, b in permutations(pressures, 2)
        for force in forces
        if a.unit == b.unit and len({force.column, a.column, b.column}) == 3
    }
    ways = [(solved(*triple), left) for triple, left in triples.items() if left < PRACTICAL_SHARE]
    fields, _ = max(ways, key=lambda way: (len(way[0]), -way[1]), default=({}, 0.0))
    sources.update(fields)


def _balance(force: FloatArray, a: FloatArray, b: FloatArray, bench: Bench, within: float = 0.3) -> float:
    """Residual share of a force's variance on A_A p_A - A_B p_B, with fitted areas; 1 if these are not the bench's.

    A fit of one common factor is tried as well: only that is identifiable if one pressure rises as the other falls, as
    with a double rod.
    """
    areas = bench.piston_area * np.array([1.0, bench.area_ratio])
    both, one = np.column_stack([a, -b]) * areas, (areas[0] * a - areas[1] * b)[:, None]
    left = 1.0
    for terms in (both, one):
        terms = np.column_stack([terms, np.ones(len(a))])
        factors, *_ = np.linalg.lstsq(terms, force, rcond=None)
        if np.all(np.abs(factors[:-1] - 1.0) < within):
            left = min(left, float(np.var(force - terms @ factors) / np.var(force)))
    return left


def _like_spring(slope: float, left: float, bench: Bench, most: float = 0.1) -> bool:
    return left < most and 0.5 < slope / bench.spring_stiffness < 2.0


def _silent(force: FloatArray) -> bool:
    """Return whether a force is computed rather than measured: it has almost no white noise, steps ignored."""
    return float(np.median(np.abs(np.diff(force, 3))) / np.sqrt(20.0) / np.std(force)) < 1e-4


def _correlation(one: FloatArray, other: FloatArray) -> float:
    return float(np.corrcoef(one, other)[0, 1]) if len(one) == len(other) else 0.0


def as_yaml(columns: ColumnMap) -> str:
    """Column map as the text of a YAML file for `--columns`."""
    words: dict[str, Any] = {}
    for field, source in columns.sources.items():
        entry = {"column": source.column, "unit": source.unit} if source.unit else {"column": source.column}
        words[field] = str(source) if source.steps or source.delay else entry
    return str(yaml.safe_dump(words, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120))


def _score(field: str, name: str, found: Columns, bench: Bench) -> float:
    """Score of a column for a field."""
    own = re.sub(r"\W+", "_", _own_name(name))
    words = _words(own)
    if _EXCLUDED_PATTERN.search(own) or (field in MEASURED_CHANNELS and any(map(_REFERENCE_PATTERN.fullmatch, words))):
        return 0.0
    score = 0.0
    if field in _FORCE_PART_PATTERNS and _is_force(name, found):
        words = [word for word in words if not _FORCE_PATTERN.fullmatch(word)] if _forces(found) > 1 else words
        own = "_".join(word for word in own.split("_") if word in words)
        score += 3.5 * any(_FORCE_PART_PATTERNS[field].fullmatch(word) for word in words)
    pattern = re.compile(_FIELD_PATTERNS[field], re.IGNORECASE)
    if score == 0.0 and own:
        said = [word for word in words if pattern.fullmatch(word)]
        plainly = (
            field in MEASURED_CHANNELS
            and any(len(word) > 3 and not _FORCE_PATTERN.fullmatch(word) for word in said)
            and not any(map(_VALVE_PATTERN.fullmatch, words))
        )
        score += 3.5 if plainly else 2.5 if pattern.fullmatch(own) else 2.0 if said else 0.0
    unit = found.unit(name)
    if unit:
        score += 1.5 if quantity(unit) == QUANTITY_OF[field] else -3.0
    scale = to_si(_unit(field, name, found, bench))
    return score + (1.0 if _fits(field, scale * found.series[name], bench) else -0.5)


def _is_force(name: str, found: Columns) -> bool:
    unit, words = found.unit(name), _words(_own_name(name))
    return quantity(unit) == "force" if unit else any(_FORCE_PATTERN.fullmatch(word) for word in words)


def _forces(found: Columns) -> int:
    """Number of columns that are measured forces."""
    named = [_own_name(name) for name in found.series if _is_force(name, found)]
    return sum(
        not _EXCLUDED_PATTERN.search(name) and not any(map(_REFERENCE_PATTERN.fullmatch, _words(name)))
        for name in named
    )


def _words(name: str) -> list[str]:
    """Words of a name: `F_load_cell` by its underscores, `JibPaCyl` by its capitals."""
    words = [word for word in re.split(r"[\W_]+", name) if word]
    capitals = [part for word in words for part in re.findall(r"[A-Z]+[a-z]*\d*|[a-z]+\d*", word)]
    return [*words, *(part for part in capitals if len(name) > 3 and part not in words)]


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
