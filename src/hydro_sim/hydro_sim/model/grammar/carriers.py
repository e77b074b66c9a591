# SPDX-License-Identifier: Apache-2.0
"""Carriers: quantities that a textbook would put into an equation, one row each."""

from __future__ import annotations

from functools import partial

from hydro_sim.model.grammar.composition import Carrier
from hydro_sim.model.laws import Number

_ACROSS = "pressure_a pressure_b"
_EDGE = "current pressure_a pressure_b"
_BEND = "(x - x_rest)"


_force, _load = partial(Carrier, "motion"), partial(Carrier, "load")

# --- forces against the motion, and of the load -----------------------------------------------------------------------

CONSTANT_FORCE = _force("force", "-", "1", "one", "A force against the motion", 1.0, "", 0.0)
DRY = _force("friction", "-", "sign(v)", "sign_v", "Dry friction", 1.0, "velocity", 0.0)
VISCOUS = _force("drag", "m/s", "v", "v", "Viscous friction", 0.05, "velocity", 1.0)
SQUARE = _force("quadratic drag", "m2/s2", "v |v|", "v * abs(v)",
                "A force against motion that grows with the square of speed", 2.5e-3, "velocity", 2.0)  # fmt: skip
ROOT = _force("root drag", "sqrt(m/s)", "sign(v) sqrt(|v|)", "v / sqrt(abs(v) + turn)",
              "A force against motion that grows with the root of speed", 0.2, "velocity", 0.5)  # fmt: skip
BY_PRESSURE = tuple(
    _force(f"friction by pressure of {chamber.upper()}", "Pa", f"sign(v) p_{chamber}", f"sign_v * p_{chamber}",
           f"Dry friction by the pressure of chamber {chamber.upper()}", 5e6, f"pressure_{chamber} velocity", 1.0)
    for chamber in "ab"
)  # fmt: skip
BY_DIFFERENCE = _force("friction by pressure difference", "Pa", "sign(v) |p_a - p_b|", "sign_v * abs(across)",
                       "Dry friction by the pressure across the piston", 3e6, f"{_ACROSS} velocity", 1.0)  # fmt: skip
STIFFNESS = _force("stiffness", "m", _BEND, _BEND, "A stiffness beside the load", 1e-2, "position", 1.0)
PRESSING = (
    _force("pressing by A", "Pa", "p_a", "p_a", "A force by the pressure of chamber A", 5e6, "pressure_a", 1.0),
    _force("pressing by B", "Pa", "p_b", "p_b", "A force by the pressure of chamber B", 5e6, "pressure_b", 1.0),
    _force("pressing by difference", "Pa", "|p_a - p_b|", "abs(across)", "A force by the pressure across the piston",
           5e6, _ACROSS, 1.0),
)  # fmt: skip
"""Of what presliding makes friction."""
LOAD_DRY = _load("rubbing", "-", "sign(v)", "sign_v", "Dry friction in the load's way", 1.0, "velocity", 0.0)
LOAD_VISCOUS = _load("damping", "m/s", "v", "v", "Damping in the load's way", 0.05, "velocity", 1.0)
LOAD_SQUARE = _load("quadratic damping", "m2/s2", "v |v|", "v * abs(v)",
                    "Damping in the load's way, with the square of speed", 2.5e-3, "velocity", 2.0)  # fmt: skip
LOAD_RUBBING = _load("rubbing by deflection", "m", "sign(v) |x - x_rest|", "sign_v * abs(x - x_rest)",
                     "Friction in the load that grows as it is bent: typical of a leaf spring", 1e-2,
                     "position velocity", 1.0)  # fmt: skip
LOAD_SPRING = _load("stiffness", "m", _BEND, _BEND, "A stiffness of the load", 1e-2, "position", 1.0)
LOAD_INERTIA = _load("inertia", "m/s2", "x''", "a", "A mass that the load drags along", 5.0, "acceleration", 1.0)
LOAD_CONSTANT = _load("load", "-", "1", "one", "A force of the load", 1.0, "", 0.0)
BENDING = _load("bending", "m", "|x - x_rest|", "abs(x - x_rest)", "A force of the load by its deflection", 1e-2,
                "position", 1.0)  # fmt: skip

# --- flows beside the valve: between the chambers, and out of one -----------------------------------------------------

LEAK = Carrier("pressure", "leak", "Pa", "(p_a - p_b)", "across", "A leak between the chambers", 3e6, _ACROSS, 1.0)
HOLE = Carrier("pressure", "hole", "sqrt(Pa)", "sqrt(p_a - p_b)", "root(across)",
               "A leak through a hole between the chambers", 2e3, _ACROSS, 0.5)  # fmt: skip


def _of_chamber(chamber: str, area: str) -> tuple[Carrier, ...]:
    equation, pressure, big = f"pressure_{chamber}", f"p_{chamber}", chamber.upper()
    return (
        Carrier(equation, "leak", "Pa", pressure, pressure, f"A leak of chamber {big} to the outside", 5e6, equation,
                1.0),
        Carrier(equation, "hole", "sqrt(Pa)", f"sqrt({pressure})", f"root({pressure})",
                f"A leak of chamber {big} through a hole", 2e3, equation, 0.5),
        Carrier(equation, "flow", "-", "1", "one", f"A flow out of chamber {big}", 1.0, "", 0.0),
        Carrier(equation, "carried oil", "m3/s", f"v A_{chamber}", f"v * {area}",
                f"Oil of chamber {big} that the motion carries along", 5e-6, "velocity", 1.0),
    )  # fmt: skip


_BESIDE = (*_of_chamber("a", "A_p"), *_of_chamber("b", "(alpha * A_p)"))
CONSTANT = tuple(one for one in _BESIDE if one.name == "flow")
CHAMBERS = tuple(one for one in _BESIDE if one.name != "flow")
CARRIED = tuple(one for one in CHAMBERS if one.name == "carried oil")

_TURNED = 1e-5
"""Current [A] over which one edge of a port takes over from the other."""


def _of_port(chamber: str, u: str, minus_u: str) -> tuple[Carrier, ...]:
    """Shares of the flow through one edge of four that do not pass, and leaks from the supply; out of the chamber.

    `u`, `minus_u`: the current that opens the edge from the supply, and the one to the tank.
    """
    equation, p, big = f"pressure_{chamber}", f"p_{chamber}", chamber.upper()
    supply, tank = f"root(p_s - {p})", f"root({p} - p_t)"
    supplied, returned = f"K * max({u}, 0.0) * {supply}", f"-(K * max({minus_u}, 0.0)) * {tank}"
    feeds = f"(0.5 + 0.5 * tanh({u} / {_TURNED}))"
    less = "passes less than the others: typical of one that is silted up or worn"

    def row(name: str, unit: str, text: str, formula: str, phrase: str, degree: float = 1.5, scale: float = 5e-6,
            uses: str = f"current {equation}", numbers: tuple[Number, ...] = ()) -> Carrier:  # fmt: skip
        return Carrier(equation, name, unit, text, formula, phrase, scale, uses, degree, numbers=numbers)

    return (
        row("flow of the supply's edge", "m3/s", f"K max({u}, 0) sqrt(p_s - {p})", supplied,
            f"The edge from the supply to chamber {big} {less}"),
        row("flow of the tank's edge", "m3/s", f"-K max({minus_u}, 0) sqrt({p} - p_t)", returned,
            f"The edge from chamber {big} to the tank {less}"),
        row("flow of the port", "m3/s", f"q_{chamber}", f"{supplied} + {returned}",
            f"Chamber {big} gets less of the valve's flow q_{chamber} than its edges pass: typical of a port that the "
            "piston covers"),
        row("throttled flow of the port", "m3/s", f"q_{chamber} (1 - 1 / sqrt(1 + resistance K^2))",
            f"({supplied} + {returned}) * (1.0 - 1.0 / sqrt(1.0 + resistance * (K * u) * (K * u)))",
            f"Flow q_{chamber} of the valve through a throttle before chamber {big}, whose pressure drop grows with "
            "q^2: typical of a narrow line or port; 1: all of it",
            numbers=(Number("resistance", "Pa s2/m6", (1e14, 5e14, 2e15, 1e16)),)),
        row("null of the port", "m3/s/A", f"-K sqrt(dp_{chamber})",
            f"-K * ({feeds} * {supply} + (1.0 - {feeds}) * {tank})",
            f"The edges of chamber {big} see a current that is shifted: typical of lands that are ground apart", 0.5,
            2e-3),
        row("leak from the supply", "Pa", f"-(p_s - {p})", f"{p} - p_s", f"A leak from the supply into chamber {big}",
            1.0, 5e6, equation),
        row("hole to the supply", "sqrt(Pa)", f"-sqrt(p_s - {p})", f"-{supply}",
            f"A leak through a hole from the supply into chamber {big}", 0.5, 2e3, equation),
    )  # fmt: skip


_EDGES = (*_of_port("a", "u", "-u"), *_of_port("b", "-u", "u"))
PORTS = tuple(one for one in _EDGES if one.name == "flow of the port")
FED = tuple(one for one in _EDGES if "supply" in one.name or "'s edge" in one.name)
OF_PORT = tuple(one for one in _EDGES if one not in (*PORTS, *FED))

# --- the valve: its spool, its edges (a share of their flow), its null by what stands across it -----------------------

NULL = Carrier("actuation", "null", "-", "1", "one", "A shift of the valve's null", 1.0, "", 0.0)
GAIN = Carrier("actuation", "gain", "A", "u", "u", "A gain of the valve", 2e-3, "current", 1.0)
CURVE = Carrier("actuation", "curve", "A2", "u |u|", "u * abs(u)",
                "A gain of the valve that changes with its opening", 4e-6, "current", 2.0)  # fmt: skip


def _edge(name: str, text: str, formula: str, phrase: str, degree: float, *numbers: Number) -> Carrier:
    return Carrier("actuation", name, "-", text, formula, phrase, 1.0, _EDGE, degree, "edges", numbers)


THROTTLE = _edge("throttled flow", "q (1 - 1 / sqrt(1 + resistance K^2))",
                 "1.0 - 1.0 / sqrt(1.0 + resistance * opened * opened)",
                 "Flow through a throttle behind or before the edges, whose pressure drop grows with q^2: typical of a "
                 "clogged filter or a narrow line; 1: all of it", 3.0,
                 Number("resistance", "Pa s2/m6", (1e14, 5e14, 2e15, 1e16)))  # fmt: skip
NARROWED = Carrier("actuation", "narrowed flow", "-", "q", "one", "Edges that pass less than their share", 1.0, _EDGE,
                   1.5, "edges", size=0.05)  # fmt: skip
JETS = _edge("flow under jets", "q dp_o / (dp_o + level)", "abs(both) / (abs(both) + level)",
             "Edges that pass less the larger the pressure drop dp_o over both that are open: typical of jets that "
             "close the spool against its spring; 1: all of it", 2.5,
             Number("level", "Pa", (1e7, 3e7, 1e8, 3e8)))  # fmt: skip
CHOKED = _edge("choked flow", "q max(1 - sqrt(choked / dp), 0)",
               "max(1.0 - sqrt(choked / max(abs(drop), choked)), 0.0)",
               "Edges that pass no more beyond a pressure drop dp: typical of oil that cavitates in its jet; 1: all of "
               "it", 1.5, Number("choked", "Pa", (1e6, 2e6, 4e6, 8e6)))  # fmt: skip


def _pressed(name: str, unit: str, text: str, formula: str, cause: str, scale: float, uses: str,
             degree: float) -> Carrier:  # fmt: skip
    return Carrier("actuation", f"null by {name}", unit, text, formula, f"The valve's null moves with {cause}", scale,
                   uses, degree, "across")  # fmt: skip


PRESSED = (
    _pressed("pressure difference", "Pa", "(p_a - p_b)", "across", "the pressure across the load: typical of a spool "
             "that it leans on", 3e6, _ACROSS, 1.0),
    _pressed("pressure of A", "Pa", "p_a", "p_a", "the pressure of chamber A: typical of a housing that it strains",
             5e6, "pressure_a", 1.0),
    _pressed("pressure of B", "Pa", "p_b", "p_b", "the pressure of chamber B: typical of a housing that it strains",
             5e6, "pressure_b", 1.0),
    _pressed("velocity", "m/s", "v", "v", "the velocity: typical of a feedback that follows the piston", 0.05,
             "velocity", 1.0),
    _pressed("position", "m", _BEND, _BEND, "the position: typical of a feedback that follows the piston", 1e-2,
             "position", 1.0),
    _pressed("opening and pressure of A", "A Pa", "u p_a", "u * p_a", "its opening times the pressure of chamber A: "
             "typical of flow forces on one land", 1e4, "current pressure_a", 2.0),
    _pressed("opening and pressure of B", "A Pa", "u p_b", "u * p_b", "its opening times the pressure of chamber B: "
             "typical of flow forces on one land", 1e4, "current pressure_b", 2.0),
    _pressed("opening and size of load", "A Pa", "u |p_a - p_b|", "u * abs(across)", "its opening times the size of "
             "the pressure across the load: typical of a spool that pressure bends or clamps", 6e3, _EDGE, 2.0),
    _pressed("opening and speed", "A m/s", "u |v|", "u * abs(v)", "its opening times the speed", 1e-4,
             "current velocity", 2.0),
    _pressed("opening and position", "A m", "u (x - x_rest)", "u * (x - x_rest)", "its opening times the position: "
             "typical of a feedback that follows the piston", 2e-5, "current position", 2.0),
    _pressed("opening and load", "A Pa", "u (p_a - p_b)", "u * across", "its opening times the pressure across the "
             "load: typical of flow forces", 6e3, _EDGE, 2.0),
)  # fmt: skip

# --- the sensors: what a reading picks up beside its signal, its zero and gain, and the reading itself ----------------

SENSORS = {
    "hydraulic_force": ("f_h", "f", "load cell at the piston rod"),
    "load_force": ("f_l", "f", "load cell at the load"),
    "pressure_a": ("p_a", "p_a", "pressure sensor of chamber A"),
    "pressure_b": ("p_b", "p_b", "pressure sensor of chamber B"),
    "piston_position": ("x", "x", "position sensor"),
}
"""By channel: its signal in a text and in a formula, and its name in a sentence."""
_BESIDE_IT = (
    ("current", "u", "u", "A", 3e-3, 1.0, "current", "the valve's current: typical of cables side by side"),
    ("position", "x", "x", "m", 2e-2, 1.0, "position", "the position: typical of a cable or a mount that is bent"),
    ("velocity", "v", "v", "m/s", 0.05, 1.0, "velocity",
     "the velocity: typical of a hose or a mount that is dragged along"),
    ("acceleration", "x''", "a", "m/s2", 5.0, 1.0, "acceleration",
     "the acceleration: typical of a body of its own that is shaken"),
    ("pressure_a", "p_a", "p_a", "Pa", 5e6, 1.0, "pressure_a",
     "the pressure of chamber A: typical of a housing that pressure strains"),
    ("pressure_b", "p_b", "p_b", "Pa", 5e6, 1.0, "pressure_b",
     "the pressure of chamber B: typical of a housing that pressure strains"),
    ("opening", "|u|", "abs(u)", "A", 3e-3, 1.0, "current",
     "the size of the valve's current: typical of a supply that sags under it"),
    ("heating", "u^2", "u * u", "A2", 1e-5, 2.0, "current",
     "the square of the valve's current: typical of an amplifier that rectifies"),
    ("speed", "|v|", "abs(v)", "m/s", 0.05, 1.0, "velocity",
     "the speed: typical of a line in which oil flows past it"),
    ("jet", "v |v|", "v * abs(v)", "m2/s2", 2.5e-3, 2.0, "velocity",
     "the square of the velocity: typical of a line in which oil flows past it"),
)  # fmt: skip


def _sensor(channel: str, name: str, unit: str, text: str, formula: str, phrase: str, scale: float, uses: str,
            degree: float) -> Carrier:  # fmt: skip
    return Carrier("sensor", f"{name} of {channel}", unit, text, formula, phrase, scale, uses, degree, channel)


def _picked(channel: str) -> list[Carrier]:
    symbol, _, sensor = SENSORS[channel]
    others = [one for one in _BESIDE_IT if one[1] != symbol]
    others = [one for one in others if channel != "piston_position" or one[0] != "acceleration"]
    return [
        _sensor(channel, f"pick-up of {name}", unit, text, formula, f"The {sensor} also reads {cause}", scale, uses,
                degree)
        for name, text, formula, unit, scale, degree, uses, cause in others
    ]  # fmt: skip


def _drifting(channel: str) -> tuple[Carrier, Carrier]:
    symbol, formula, sensor = SENSORS[channel]
    unit, scale, uses = ("N", 500.0, channel) if symbol.startswith("f") else ("Pa", 5e6, channel)
    unit, scale, uses = ("m", 4e-2, "position") if channel == "piston_position" else (unit, scale, uses)
    return (_sensor(channel, "zero", "-", "1", "one", f"A zero of the {sensor}", 1.0, "", 0.0),
            _sensor(channel, "gain", unit, symbol, formula, f"A gain of the {sensor}", scale, uses, 1.0))  # fmt: skip


PICKED = tuple(carrier for channel in SENSORS for carrier in _picked(channel))
BENT_BY_LOAD = _sensor("piston_position", "pick-up of deflection", "m", _BEND, _BEND, "The position sensor also reads "
                       "the load's deflection: typical of a bracket that bends under the load", 1e-2, "position",
                       1.0)  # fmt: skip
DRIFTING = tuple(carrier for channel in SENSORS for carrier in _drifting(channel))
GAINS_OF = {channel: _drifting(channel)[1] for channel in SENSORS if channel != "piston_position"}
READ = {
    channel: _sensor(channel, "reading", "-", "1", "one", f"The {sensor} reads otherwise", 1.0, "", 0.0)
    for channel, (_, _, sensor) in SENSORS.items()
}
"""By channel: 1, which a modulation by its own signal makes a law of its reading."""
