# SPDX-License-Identifier: Apache-2.0
"""Candidate terms of closures: smooth functions of one signal with their textbook shapes, and laws with memory.

A term of an equation is a smooth function of an argument (`model.tables`), alone or times a factor. `CURVES` lists the
functions that are searched for in each equation and the laws that may be derived from each: a factor times one of
`SHAPES`. `LAWS` also has terms that are no static function of one signal: laws with memory, of the valve's edges, and
crosstalk of other signals into a sensor.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hydro_sim.model.laws import Law, MemoryElement, ShapeParameter, with_reversal_velocity
from hydro_sim.model.tables import FACTORS, VARIABLE_SIGNALS, Factor, Table

_NOTICEABLE_SIZES = {"motion": ("N", 5.0), "load": ("N", 5.0), "pressure": ("m3/s", 3e-7), "pressure_a": ("m3/s", 3e-7),
            "pressure_b": ("m3/s", 3e-7), "actuation": ("A", 1e-4)}  # fmt: skip
"""Unit and noticeable size of the terms of an equation."""
_SENSORS = {"hydraulic_force": ("N", 5.0, "f_h", "load cell at the piston rod"),
            "load_force": ("N", 5.0, "f_l", "load cell at the load"),
            "pressure_a": ("Pa", 5e4, "p_a", "pressure sensor of chamber A"),
            "pressure_b": ("Pa", 5e4, "p_b", "pressure sensor of chamber B"),
            "piston_position": ("m", 1e-5, "x", "position sensor")}  # fmt: skip
"""Unit and noticeable size of a sensor's error, its signal and its name."""


@dataclass(frozen=True)
class _Argument:
    text: str
    formula: str
    unit: str
    scale: float
    """Typical magnitude."""
    words: str
    centred: str = ""
    """Formula relative to the signal's rest, if that is not 0: for the position, the rest of the load's spring."""
    sign: str = ""
    """Formula of its sign, rounded at the reversal."""
    root: str = ""


_ARGUMENTS = {
    "position": _Argument("x", "x", "m", 1e-2, "the position", "(x - x_rest)"),
    "velocity": _Argument("v", "v", "m/s", 0.05, "the velocity", "", "sign_v", "v / sqrt(abs(v) + turn)"),
    "pressure_difference": _Argument("(p_a - p_b)", "across", "Pa", 3e6, "the pressure difference", "",
                                     "tanh(across / 3e4)", "root(across)"),
    "pressure_a": _Argument("p_a", "p_a", "Pa", 5e6, "the pressure of chamber A", root="root(p_a)"),
    "pressure_b": _Argument("p_b", "p_b", "Pa", 5e6, "the pressure of chamber B", root="root(p_b)"),
    "current": _Argument("u", "u", "A", 2e-3, "the current", "", "tanh(u / 1e-5)"),
    "acceleration": _Argument("x''", "a", "m/s2", 5.0, "the acceleration"),
    "hydraulic_force": _Argument("f_h", "f", "N", 100.0, "the force"),
    "load_force": _Argument("f_l", "f", "N", 100.0, "the force"),
}  # fmt: skip


@dataclass(frozen=True)
class Shape:
    """Textbook shape of a smooth function."""

    text: str
    """Text of the formula; {s}: the argument, {c}: the argument relative to its rest."""
    formula: str
    degree: float
    """Power of the argument in the formula."""
    words: str
    """Description; {s}: the argument's name."""
    shape_parameters: tuple[str, ...] = ()
    """Shape parameters besides the coefficient: see `_shape_parameter`."""


SHAPES = {
    "constant": Shape("", "one", 0.0, "alone"),
    "": Shape("{c}", "{c}", 1.0, "in proportion to {s}"),
    "absolute": Shape("|{c}|", "abs({c})", 1.0, "in proportion to the size of {s}"),
    "quadratic": Shape("{c} |{c}|", "{c} * abs({c})", 2.0, "that grows with the square of {s}"),
    "even quadratic": Shape("{c}^2", "{c} * {c}", 2.0, "with the square of {s}, whatever its sign"),
    "cubic": Shape("{c}^3", "{c} * {c} * {c}", 3.0, "that grows with the cube of {s}"),
    "root": Shape("sign({c}) sqrt(|{c}|)", "{root}", 0.5, "that grows with the root of {s}"),
    "saturating": Shape("{c} / sqrt(1 + ({c} / level)^2)", "{c} / sqrt(1.0 + ({c} / level) * ({c} / level))", 1.0,
                        "that grows ever less with {s}", ("level",)),
    "fading": Shape("exp(-|{c}| / level)", "exp(-abs({c}) / level)", 0.0, "that fades with the size of {s}",
                    ("level",)),
    "beyond": Shape("sign({c}) max(|{c}| - threshold, 0)", "max({c} - threshold, 0.0) - max(-{c} - threshold, 0.0)",
                    1.0, "that begins at a size of {s}", ("size",)),
    "rising": Shape("max({s} - threshold, 0)", "max({s} - threshold, 0.0)", 1.0, "that begins above a value of {s}",
                    ("threshold",)),
    "falling": Shape("max(threshold - {s}, 0)", "max(threshold - {s}, 0.0)", 1.0, "that begins below a value of {s}",
                     ("threshold",)),
    "local": Shape("exp(-(({s} - centre) / width)^2)", "exp(-((({s} - centre) / width) ** 2))", 0.0,
                   "about one value of {s}", ("centre", "width")),
    "positive": Shape("where {s} > 0", "max({sign}, 0.0)", 0.0, "only while {s} is positive"),
    "negative": Shape("where {s} < 0", "max(-({sign}), 0.0)", 0.0, "only while {s} is negative"),
}  # fmt: skip
"""Shapes by the adjective in their laws' names; a straight line has none."""
_ODD_SHAPES = ("root", "quadratic", "cubic", "beyond", "saturating")
_STROKE_SHAPES = ("", "absolute", "even quadratic", "rising", "falling", "local")
_ONE_SIDED_SHAPES = ("positive", "negative")
_HINTS = {
    "quadratic drag": "oil forced through a port", "root drag": "seals whose oil film grows",
    "beyond drag": "a port that chokes or a valve that shuts",
    "local friction along the stroke": "wear, a dent or a score where the cylinder works most",
    "friction along the stroke": "a rod that is bent or a bore that is worn",
    "friction by pressure of A": "a piston seal that pressure presses on",
    "friction by pressure of B": "a rod's seal that pressure presses on",
    "absolute friction by pressure difference": "a piston seal",
    "rising stiffness": "a second spring or a stop that engages", "rising spring": "coils that touch, or a bumper",
    "falling spring": "a second spring that engages", "absolute rubbing along the stroke": "a leaf spring, or a guide",
    "local leak along the stroke": "wear where the cylinder works most",
    "rising leak of A": "a relief valve", "rising leak of B": "a relief valve",
    "positive leak of B by velocity": "a rod seal that is worn on one side", "root leak of A": "a hole or a scratch",
    "root leak of B": "a hole or a scratch", "saturating opening": "a torque motor whose iron saturates",
    "quadratic opening": "edges with round ports", "beyond opening": "ports of two widths",
}  # fmt: skip


@dataclass(frozen=True)
class Curve:
    """Smooth function in an equation, and the laws that may be derived from it."""

    table: Table
    laws: tuple[Law, ...]


def _shape_parameter(name: str, variable: str) -> ShapeParameter:
    """A threshold or centre, within its signal's recorded range, or a level or width of its typical size."""
    unit, scale = _ARGUMENTS[variable].unit, _ARGUMENTS[variable].scale
    sizes = tuple(share * scale for share in (0.2, 0.5, 1.0, 2.0, 5.0))
    if name == "size":
        size = {"velocity": "speed", "current": "opening"}.get(variable, variable)
        return ShapeParameter("threshold", unit, sizes, size)
    if name in ("threshold", "centre"):
        return ShapeParameter(name, unit, sizes, variable)
    return ShapeParameter(name, unit, sizes[:4] if name == "width" else sizes)


def _law(equation: str, noun: str, what: str, variable: str, adjective: str, factor: Factor | None, where: str) -> Law:
    argument, shape = _ARGUMENTS[variable], SHAPES[adjective]
    unit, size = _SENSORS[where][:2] if where in _SENSORS else _NOTICEABLE_SIZES[equation]
    own = [argument.unit] * int(shape.degree) + ([f"sqrt({argument.unit})"] if shape.degree % 1.0 else [])
    formula = shape.formula.format(s=argument.formula, c=argument.centred or argument.formula, root=argument.root,
                                   sign=argument.sign)  # fmt: skip
    text = shape.text.format(s=argument.text, c=argument.centred or argument.text)
    text = re.sub(r"\|\((.*?)\)\|", r"|\1|", text)
    name = f"{adjective} {noun}".strip()
    hint = f": typical of {_HINTS[name]}" if name in _HINTS else ""
    uses = set() if adjective == "constant" else set(VARIABLE_SIGNALS.get(variable, variable).split())
    return Law(
        equation=equation, form=name, unit=divide_units(unit, *own, *([factor.unit] if factor else [])),
        text=f"{factor.text} {text}".strip() if factor else text,
        formula=f"({factor.formula}) * ({formula})" if factor else formula,
        typical=size / ((factor.scale if factor else 1.0) * argument.scale**shape.degree),
        sentence=f"{what} {shape.words.format(s=argument.words)}{hint}.", where=where,
        shape_parameters=tuple(_shape_parameter(one, variable) for one in shape.shape_parameters),
        uses=frozenset(uses | set(factor.uses.split() if factor else ())),
        degree=shape.degree + (factor.degree if factor else 0.0),
    )  # fmt: skip


def _curve(
    equation: str, noun: str, what: str, variable: str, shapes: Sequence[str], factor: str = "", *, where: str = "",
    odd: bool = False,
) -> Curve:  # fmt: skip
    """A smooth function of a signal; `odd`: of the speed times the direction, for laws of the velocity."""
    laws = tuple(_law(equation, noun, what, variable, one, FACTORS.get(factor), where) for one in shapes)
    times = FACTORS["direction" if odd else factor] if odd or factor else None
    unit, size = _SENSORS[where][:2] if where else _NOTICEABLE_SIZES[equation]
    over = "speed" if odd else "force" if variable.endswith("force") else variable
    whole, size = (divide_units(unit, times.unit), size / times.scale) if times else (unit, size)
    return Curve(Table(equation, over, whole, size, times, where), laws)


_SYMBOL = r"sqrt\([^)]*\)|[A-Za-z]+"


def divide_units(unit: str, *others: str) -> str:
    """Return a unit such as "N s/m2" divided by other units; a slash divides by the next symbol only."""
    powers: dict[str, int] = {}
    for sign, one in ((1, unit), *((-1, other) for other in others)):
        for over, name, power in re.findall(rf"(^|[ /])({_SYMBOL})(\d*)", one):
            powers[name] = powers.get(name, 0) + sign * (-1 if over == "/" else 1) * int(power or 1)
    written = [(power, f"{name}{abs(power) if abs(power) > 1 else ''}") for name, power in powers.items()]
    above = " ".join(one for power, one in written if power > 0)
    below = "".join(f"/{one}" for power, one in written if power < 0)
    return (above or "1") + below if above or below else "-"


_AGAINST, _BESIDE, _OF_LOAD = "A force against the motion", "A force on the piston", "A force of the load"
_BETWEEN = "A leak between the chambers"
CURVES: tuple[Curve, ...] = (
    _curve("motion", "drag", _AGAINST, "velocity", _ODD_SHAPES, odd=True),
    _curve("motion", "uneven drag", _BESIDE, "velocity", ("even quadratic", "rising", "falling")),
    _curve("motion", "stiffness", _BESIDE, "position", ("", "absolute", "quadratic", "cubic", "saturating", "rising",
                                                        "falling", "local")),
    _curve("motion", "friction along the stroke", "Dry friction", "position", _STROKE_SHAPES, "direction"),
    _curve("motion", "drag along the stroke", "Viscous friction", "position", _STROKE_SHAPES, "velocity"),
    *(_curve("motion", f"{noun} by {name}", what, variable, shapes, factor)
      for noun, what, factor in (("friction", "Dry friction", "direction"), ("drag", "Viscous friction", "velocity"))
      for name, variable, shapes in (
          ("pressure of A", "pressure_a", ("", "rising", "falling")),
          ("pressure of B", "pressure_b", ("", "rising", "falling")),
          ("pressure difference", "pressure_difference", ("absolute", "rising", "falling", *_ONE_SIDED_SHAPES)))),
    _curve("load", "spring", _OF_LOAD, "position", ("", "absolute", "quadratic", "saturating", "rising", "falling",
                                                    "local")),
    _curve("load", "damping", _OF_LOAD, "velocity", ("", *_ODD_SHAPES), odd=True),
    _curve("load", "uneven damping", _OF_LOAD, "velocity", ("even quadratic", "rising", "falling")),
    _curve("load", "rubbing along the stroke", "Dry friction in the load's way", "position",
           ("constant", *_STROKE_SHAPES), "direction"),
    _curve("load", "damping along the stroke", "Damping in the load's way", "position", _STROKE_SHAPES, "velocity"),
    _curve("pressure", "leak", _BETWEEN, "pressure_difference",
           ("quadratic", "root", "rising", "falling", *_ONE_SIDED_SHAPES)),
    _curve("pressure", "leak along the stroke", _BETWEEN, "position", _STROKE_SHAPES, "pressure_difference"),
    _curve("pressure", "leak by velocity", _BETWEEN, "velocity", ("absolute", "fading", *_ONE_SIDED_SHAPES),
           "pressure_difference"),
    _curve("pressure", "leak by current", _BETWEEN, "current", ("absolute", "fading", *_ONE_SIDED_SHAPES),
           "pressure_difference"),
    *(one for chamber in "ab" for big in (chamber.upper(),) for what in (f"A leak of chamber {big} to the outside",)
      for one in (
          _curve(f"pressure_{chamber}", f"leak of {big}", what, f"pressure_{chamber}",
                 ("", "even quadratic", "root", "rising", "falling")),
          _curve(f"pressure_{chamber}", f"leak of {big} along the stroke", what, "position", _STROKE_SHAPES,
                 f"pressure_{chamber}"),
          _curve(f"pressure_{chamber}", f"leak of {big} by velocity", what, "velocity",
                 ("absolute", "fading", *_ONE_SIDED_SHAPES), f"pressure_{chamber}"),
          _curve(f"pressure_{chamber}", f"oil of {big} that motion carries", f"Oil of chamber {big} that the motion "
                 "carries along", "position", _STROKE_SHAPES, "velocity"))),
    _curve("actuation", "opening", "An opening of the valve", "current",
           ("absolute", "quadratic", "even quadratic", "cubic", "saturating", "beyond", "rising", "falling")),
    *(_curve("sensor", f"reading of {channel}", f"The {_SENSORS[channel][3]} reads more, by an amount", channel, shapes,
             where=channel)
      for channel, shapes in (
          *((cell, ("absolute", "quadratic", "even quadratic", "cubic", "beyond", "rising", "falling"))
            for cell in ("hydraulic_force", "load_force")),
          *((gauge, ("", "even quadratic", "rising", "falling")) for gauge in ("pressure_a", "pressure_b")))),
)  # fmt: skip
"""Smooth functions that are searched for in each equation."""

# --- terms with memory, of the valve's edges, and of sensors by other signals -----------------------------------------

_LAG_TIME = ShapeParameter("time", "s", (0.03, 0.1, 0.3, 1.0, 3.0))


def _slow(
    equation: str, noun: str, what: str, factor: Factor | None = None, over: str = "time", where: str = ""
) -> Law:
    """Law with a slow first-order state, driven by time, by past speed, or by past opening of the valve (`over`)."""
    unit, size = _SENSORS[where][:2] if where else _NOTICEABLE_SIZES[equation]
    text, formula, uses = (f"{factor.text} ", f"({factor.formula}) * w", factor.uses) if factor else ("", "one * w", "")
    driver, symbol, name = {"time": ("time", "", "from the start"), "speed": ("velocity", "|v|", "by past motion"),
                            "opening": ("current", "|u|", "by past opening of the valve")}[over]  # fmt: skip
    by = None if over == "time" else _ARGUMENTS[driver]
    return Law(
        equation=equation, form=f"{noun} {name}",
        unit=divide_units(unit, *([factor.unit] if factor else []), *([by.unit] if by else [])),
        text=f"{text}w, w' = ({symbol} - w) / time" if by else f"{text}(1 - exp(-t / time))", formula=formula,
        typical=size / ((factor.scale if factor else 1.0) * (by.scale if by else 1.0)),
        sentence=f"{what} that settles slowly {name} of a recording: typical of what warms.".replace(
            " of a recording", " of a recording" if by is None else ""),
        memory_element=MemoryElement("slow", over),
        shape_parameters=(ShapeParameter("time", "s", (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)),), where=where,
        uses=frozenset(f"{uses} {driver}".split()), degree=(factor.degree if factor else 0.0) + (1.0 if by else 0.0),
    )  # fmt: skip


def _creeping(equation: str, name: str, what: str, variable: str, coefficient: float) -> Law:
    """Law of a signal less its first-order lag (a high-pass), as of creep."""
    argument = _ARGUMENTS[variable]
    return Law(equation=equation, form=name, unit=divide_units(_NOTICEABLE_SIZES[equation][0], argument.unit),
               text=f"({argument.text} - w), w' = ({argument.text} - w) / time", formula=f"{argument.formula} - w",
               typical=coefficient, sentence=what, memory_element=MemoryElement("lag", variable),
               shape_parameters=(_LAG_TIME,), uses=frozenset({variable}), degree=1.0)  # fmt: skip


def _hysteresis(equation: str, name: str, what: str, signal: str, coefficient: float, paths: Sequence[float],
                where: str = "") -> Law:  # fmt: skip
    """Law with hysteresis in a signal (Dahl 1968)."""
    unit = _SENSORS[where][0] if where else _NOTICEABLE_SIZES[equation][0]
    argument = _ARGUMENTS[where if signal == "force" else signal]
    moved = "(v - |v| w)" if signal == "position" else f"({argument.text}' - |{argument.text}'| w)"
    uses = {"position", "velocity"} if signal == "position" else {where or signal}
    return Law(equation=equation, form=name, unit=unit, text=f"w, w' = {moved} / path", formula="w",
               typical=coefficient, sentence=f"{what} follows another path back than forth: typical of what rubs, has "
               "play or stays magnetic.", memory_element=MemoryElement("path", signal),
               shape_parameters=(ShapeParameter("path", argument.unit, tuple(paths)),), where=where,
               uses=frozenset(uses), degree=1.0)  # fmt: skip


_MEMORY_ELEMENT_LAWS: tuple[Law, ...] = (
    *(_creeping(equation, name, f"{what} that relaxes where the piston is held: typical of rubber, plastic or trapped "
                "gas.", "position", 1e3)
      for equation, name, what in (("motion", "creeping stiffness", _BESIDE), ("load", "creeping spring", _OF_LOAD))),
    *(_creeping(f"pressure_{chamber}", "creeping volume", f"Chamber {chamber.upper()} goes on taking oil after its "
                "pressure has risen: typical of a hose that creeps.", f"pressure_{chamber}", 1e-13)
      for chamber in "ab"),
    Law("actuation", "late share", "-", "(w - u), w' = (u - w) / time", "w - u", 0.1,
        "A share of the opening that comes late: typical of eddies in a torque motor's iron, or of a spool that "
        "creeps; 1: all of it.", MemoryElement("lag", "current"),
        (ShapeParameter("time", "s", (0.01, 0.03, 0.1, 0.3, 1.0)),),
        uses=frozenset({"current"}), degree=1.0),
    _hysteresis("load", "hysteresis", "The load", "position", 5.0, (3e-4, 1e-3, 3e-3, 1e-2)),
    _hysteresis("actuation", "hysteresis", "The opening of the valve", "current", 2e-4, (1e-4, 3e-4, 1e-3, 3e-3)),
    _hysteresis("sensor", "hysteresis of piston_position", "The position sensor", "position", 1e-5,
                (1e-4, 3e-4, 1e-3, 3e-3), "piston_position"),
    *(law for cell in ("hydraulic_force", "load_force") for law in (
        _hysteresis("sensor", f"hysteresis of {cell}", f"The {_SENSORS[cell][3]}", "force", 5.0,
                    (3.0, 10.0, 30.0, 100.0), cell),
        Law("sensor", f"creep of {cell}", "-", f"w, w' = ({_SENSORS[cell][2]} - w) / time", "w", 0.05,
            f"The {_SENSORS[cell][3]} goes on rising under a force that stays: typical of a glued strain gauge.",
            MemoryElement("lag", "force"), (_LAG_TIME,), cell, frozenset({cell}), 1.0))),
    *(_slow(equation, noun, what, FACTORS.get(factor), over)
      for equation, noun, what, factor, overs in (
          ("motion", "force", _BESIDE, "", "time"), ("motion", "friction", "Dry friction", "direction", "time speed"),
          ("motion", "drag", "Viscous friction", "velocity", "time speed"), ("load", "load", _OF_LOAD, "", "time"),
          ("load", "rubbing", "Dry friction in the load's way", "direction", "time"),
          ("pressure", "leak", _BETWEEN, "pressure_difference", "time speed opening"),
          ("pressure_a", "leak", "A leak of chamber A", "pressure_a", "time speed"),
          ("pressure_b", "leak", "A leak of chamber B", "pressure_b", "time speed"),
          ("actuation", "null", "A shift of the valve's null", "", "time opening"),
          ("actuation", "gain", "A gain of the valve", "current", "time opening"))
      for over in overs.split()),
    *(_slow("sensor", f"zero of {channel}", f"A zero of the {sensor}", where=channel)
      for channel, (*_, sensor) in _SENSORS.items()),
)  # fmt: skip
_EDGE_SIGNALS = frozenset({"current", "pressure_a", "pressure_b"})
_OTHER_LAWS: tuple[Law, ...] = (
    Law("load", "inertia", "kg", "x''", "a", 1.0, "A mass that the load drags along.", uses=frozenset({"acceleration"}),
        degree=1.0),
    Law("actuation", "throttled flow", "-", "q (1 - 1 / sqrt(1 + resistance K^2))",
        "1.0 - 1.0 / sqrt(1.0 + resistance * conductance * conductance)", 1.0,
        "Flow through a throttle behind or before the "
        "edges, whose pressure drop grows with q^2: typical of a clogged filter or a narrow line; 1: all of it.",
        None, (ShapeParameter("resistance", "Pa s2/m6", (1e14, 5e14, 2e15, 1e16)),), "edges", _EDGE_SIGNALS, 3.0),
    Law("actuation", "laminar edges", "-", "q (1 - sqrt(|dp| / (|dp| + transition)))",
        "1.0 - sqrt((abs(drop) + laminar) / (abs(drop) + laminar + transition))", 1.0,
        "Edges that pass less at small pressure drops: typical of flow that is laminar below and turbulent above; "
        "1: all of it.", None, (ShapeParameter("transition", "Pa", (1e5, 3e5, 1e6, 3e6)),), "edges", _EDGE_SIGNALS,
        1.0),
    Law("actuation", "flow force", "1/Pa", "q |dp|", "abs(drop)", 1e-9, "Edges that pass less the larger the pressure "
        "drop: typical of flow forces that close the spool, or of oil that cavitates.",
        None, (), "edges", _EDGE_SIGNALS, 2.5),
    *(_law("actuation", f"null by {variable}", "The valve's null moves", variable, "", None, "across")
      for variable in ("pressure_difference", "pressure_a", "pressure_b", "velocity", "position")),
    *(_law("actuation", "null by opening and load", "The valve's null moves with its opening,", "pressure_difference",
           adjective, FACTORS["current"], "across") for adjective in ("", "absolute")),
    *(_law("sensor", f"pick-up of {variable} by {channel}", f"The {sensor} reads more, by an amount", variable, "",
           None, channel)
      for channel, (*_, sensor) in _SENSORS.items()
      for variable in ("current", "position", "velocity", "pressure_a", "pressure_b", "acceleration")
      if variable != channel and (channel, variable) != ("piston_position", "acceleration")),
)  # fmt: skip
MEMORY_LAWS: tuple[Law, ...] = (*_MEMORY_ELEMENT_LAWS, *_OTHER_LAWS)
"""Laws with memory or of several signals."""
LAWS: tuple[Law, ...] = (*(law for curve in CURVES for law in curve.laws), *MEMORY_LAWS)
LAWS_WITH_REVERSAL_VELOCITY = tuple(with_reversal_velocity(law) for law in LAWS if law.depends_on_direction)
"""Laws that depend on the sign of the velocity, with the reversal velocity as a parameter."""
TABLES = tuple(curve.table for curve in CURVES)
_ALL_FORMS: tuple[Law | Table, ...] = (*LAWS, *LAWS_WITH_REVERSAL_VELOCITY, *TABLES)
FORMS: dict[tuple[str, str], Law | Table] = {(one.equation, one.form): one for one in _ALL_FORMS}
"""Laws and tables by equation and form."""


def _of(closure: Mapping[str, Any]) -> Law | Table | None:
    return FORMS.get((str(closure["equation"]), str(closure["form"])))


def has_hidden_states(closure: Mapping[str, Any]) -> bool:
    """Return whether an entry of a bench file's `closures` has hidden states."""
    law = _of(closure)
    return law is not None and law.has_hidden_states


def depends_on_direction(closure: Mapping[str, Any]) -> bool:
    """Return whether an entry of a bench file's `closures` is a law that depends on the sign of the velocity."""
    law = _of(closure)
    return isinstance(law, Law) and law.depends_on_direction


def signals_of(closure: Mapping[str, Any]) -> frozenset[str]:
    """Return the signals in the law of an entry of a bench file's `closures`."""
    law = _of(closure)
    return frozenset() if law is None else law.uses
