# SPDX-License-Identifier: Apache-2.0
"""Modulations of carriers, one row each: gates, hinges, places, levels, slow states, the past, products."""

from __future__ import annotations

import numpy as np

from hydro_sim.model.grammar.composition import Modulation
from hydro_sim.model.laws import Element, Number

ALWAYS = Modulation("", "{}", "1.0", "")

TIMES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Start values [s] of slow states."""
LAG = (Number("time", "s", (0.03, 0.1, 0.3, 1.0, 3.0)),)
_WARMING = (Number("time", "s", TIMES),)


def threshold(over: str, unit: str, *probes: float) -> tuple[Number, ...]:
    """Where a law begins; `probes` stand for quantiles of a recording."""
    return (Number("threshold", unit, probes, over),)


def path(unit: str, *probes: float) -> tuple[Number, ...]:
    """The path over which a hysteresis turns."""
    return (Number("path", unit, probes),)


PLACE = threshold("position", "m", 0.024, 0.034, 0.04, 0.046, 0.056)
SPEED = threshold("speed", "m/s", 0.01, 0.03, 0.06, 0.1, 0.2)
LEVELS = (3e6, 4e6, 5e6, 6e6, 8e6)
"""Start values [Pa] of a threshold of a pressure."""

# --- gates: 1 where a signal has a sign, else 0, rounded --------------------------------------------------------------


def _gate(name: str, text: str, formula: str, phrase: str, uses: str, signal: str, side: float) -> Modulation:
    return Modulation(name, f"{{}} where {text}", f"max({formula}, 0.0)", phrase, uses, gate=(signal, side))


BY_MOTION = (
    _gate("outwards", "v > 0", "sign_v", ", only while the piston moves out", "velocity", "velocity", 1.0),
    _gate("inwards", "v < 0", "-sign_v", ", only while the piston moves in", "velocity", "velocity", -1.0),
)
BY_PRESSURE = (
    _gate("driven out", "p_a > p_b", "tanh(across / 3e4)", ", only while chamber A has the higher pressure: typical of "
          "a check valve or lip", "pressure_a pressure_b", "pressure_difference", 1.0),
    _gate("driven in", "p_a < p_b", "-tanh(across / 3e4)", ", only while chamber B has the higher pressure: typical of "
          "a check valve or lip", "pressure_a pressure_b", "pressure_difference", -1.0),
)  # fmt: skip
BY_SIDE = (
    _gate("to one side", "u > 0", "tanh(u / 1e-5)", ", only while the spool is opened one way", "current", "current",
          1.0),
    _gate("to the other side", "u < 0", "-tanh(u / 1e-5)", ", only while the spool is opened the other way", "current",
          "current", -1.0),
)  # fmt: skip
BY_EDGE = (
    Modulation("of the supply", "{} at the supply", "feeds", ", at the edges to the supply"),
    Modulation("of the return", "{} at the return", "1.0 - feeds", ", at the edges to the tank"),
)

# --- from a threshold on, at a place, and what repeats along the stroke -----------------------------------------------


def _hinges(symbol: str, formula: str, name: str, unit: str, scale: float, uses: str,
            numbers: tuple[Number, ...]) -> tuple[Modulation, ...]:  # fmt: skip
    return (
        Modulation(f"above a {name}", f"{{}} max({symbol} - threshold, 0)", f"max({formula} - threshold, 0.0)",
                   f", from a {name} on", uses, unit, scale, 1.0, numbers=numbers),
        Modulation(f"below a {name}", f"{{}} max(threshold - {symbol}, 0)", f"max(threshold - {formula}, 0.0)",
                   f", below a {name}", uses, unit, scale, 1.0, numbers=numbers),
    )  # fmt: skip


BEYOND_PLACE = _hinges("x", "x", "place", "m", 1e-2, "position", PLACE)
BEYOND_SPEED = _hinges("|v|", "abs(v)", "speed", "m/s", 0.05, "velocity", SPEED)
BEYOND_PRESSURE = tuple(
    hinge
    for chamber in "ab"
    for hinge in _hinges(f"p_{chamber}", f"p_{chamber}", f"pressure of {chamber.upper()}", "Pa", 1e6,
                         f"pressure_{chamber}", threshold(f"pressure_{chamber}", "Pa", *LEVELS))
)  # fmt: skip
BEYOND_OPENING = _hinges("u", "u", "signed opening", "A", 2e-3, "current",
                         threshold("current", "A", -3e-3, -1e-3, 1e-4, 1e-3, 3e-3))  # fmt: skip
AT_PLACE = Modulation(
    "at a place", "{} exp(-((x - centre) / width)^2)", "exp(-(((x - centre) / width) ** 2))",
    ", at one place of the stroke: typical of wear or a score where the cylinder works most", "position",
    numbers=(Number("centre", "m", PLACE[0].probes, "position"), Number("width", "m", (2e-3, 5e-3, 1.2e-2))),
)  # fmt: skip
_PITCHES = tuple(round(1.0 / (62.5 + 31.25 * k), 6) for k in range(-1, 15))
"""Start values [m] of a pitch, 32 mm to 2 mm: apart by as much as a range of 3 cm tells."""
_PHASE = Number("phase", "-", (np.pi, 1.5 * np.pi))
_SINE = "sin(2.0 * pi * x / pitch + phase)"
RIPPLE = Modulation(
    "in ripples", "{} sin(2 pi x / pitch + phase)", _SINE,
    ", again and again along the stroke: typical of a scale, a thread or a tooth", "position",
    numbers=(Number("pitch", "m", tuple(sorted(_PITCHES))), _PHASE),
)  # fmt: skip
WAVES = Modulation(
    "in waves", "{} (1 + sin(2 pi x / pitch + phase)) / 2", f"0.5 + 0.5 * {_SINE}",
    ", again and again along the stroke, between nothing and all: typical of a bore that a hone has left in waves",
    "position", numbers=(Number("pitch", "m", tuple(sorted(_PITCHES[1:]))), _PHASE),  # a wave of the range is a trend
)  # fmt: skip

# --- by speed, and by slow states: they follow a driver over a time, from 0 -------------------------------------------

LEVELLING = Modulation(
    "levelling off", "{} / (1 + |v| / level)", "1.0 / (1.0 + abs(v) / level)",
    " that levels off with speed: typical of oil that shears thin", "velocity",
    numbers=(Number("level", "m/s", (0.01, 0.03, 0.1)),),
)  # fmt: skip
FILM = Modulation(
    "under a late film", "{} exp(-(w / speed)^2), w' = (v - w) / time", "exp(-((w / speed) ** 2))",
    " that fades with speed, late: typical of a film that takes time to form", "velocity",
    element=Element("slow", "velocity"),
    numbers=(Number("speed", "m/s", (0.01, 0.03, 0.1)), Number("time", "s", (0.01, 0.03, 0.1))),
)  # fmt: skip


def _slow(driver: str, symbol: str, name: str, unit: str, scale: float, uses: str, cause: str,
          *faster: float) -> Modulation:  # fmt: skip
    """What work, motion or time alone has warmed; `faster`: start values [s] before `TIMES`."""
    return Modulation(
        f"as {name} warms", f"{{}} w, w' = ({symbol} - w) / time", "w", f" that grows slowly with {cause}", uses, unit,
        scale, element=Element("slow", driver), numbers=(Number("time", "s", (*faster, *TIMES)),),
    )  # fmt: skip


BY_MOTION_PAST = _slow("speed", "|v|", "motion", "m/s", 0.05, "velocity",
                       "past motion: typical of seals, oil or grease that warm", 0.02, 0.1)  # fmt: skip
BY_THROTTLING = _slow("opening", "|u|", "throttling", "A", 1e-3, "current",
                      "the valve's past opening: typical of throttled oil that warms")  # fmt: skip
BY_HEATING = _slow("heating", "u^2", "the coil", "A2", 1e-6, "current",
                   "the square of past current: typical of a coil that warms")  # fmt: skip
BY_LOADING = _slow("size_of_difference", "|p_a - p_b|", "pressure", "Pa", 1e6, "pressure_a pressure_b",
                   "past pressure: typical of parts that give slowly")  # fmt: skip
BY_TIME = Modulation(
    "from the start", "{} (1 - exp(-t / time))", "w",
    " that settles from the start of a recording: typical of what warms after it is switched on", "time",
    element=Element("slow", "time"), numbers=_WARMING,
)  # fmt: skip
FADING = Modulation(
    "fading from the start", "{} exp(-t / time)", "1.0 - w",
    " that fades from the start of a recording: typical of a bench that starts cold", "time",
    element=Element("slow", "time"), numbers=_WARMING,
)  # fmt: skip

# --- by the path since a reversal, by rest, and by a pressure's past --------------------------------------------------


def _turned(name: str, text: str, formula: str, phrase: str) -> Modulation:
    return Modulation(name, f"{{}} {text}, w' = (v - |v| w) / path", formula, phrase, "velocity",
                      element=Element("path", "position"), numbers=path("m", 1e-4, 3e-4, 1e-3, 3e-3))  # fmt: skip


def _wiped(name: str, text: str, formula: str, phrase: str) -> Modulation:
    numbers = Number("path", "m", (2e-3, 6e-3, 2e-2)), Number("time", "s", (0.05, 0.15, 0.5))
    return Modulation(name, f"{{}} {text}, w' = |v| / path - w / time", formula, phrase, "velocity",
                      element=Element("heat", "position"), numbers=numbers)  # fmt: skip


REVERSED = _turned(
    "since a reversal", "(1 - w^2)", "1.0 - w * w",
    ", while the piston turns round: typical of a ring that leaves its seat, or of a film that tears",
)  # fmt: skip
SEATED = _turned(
    "beyond a reversal", "w^2", "w * w",
    ", but while the piston turns round: typical of a ring that seals again once it is dragged along",
)  # fmt: skip
PRESLIDING = _turned(
    "with presliding", "w", "w",
    ", that gives a little before it slides: typical of strands, leaves or lips that stick to each other first",
)  # fmt: skip
RESTED = _wiped(
    "after rest", "exp(-w)", "exp(-w)",
    ", that fades as the piston moves and returns at rest: typical of a film that is squeezed out at rest",
)  # fmt: skip
WIPED = _wiped(
    "after motion", "(1 - exp(-w))", "1.0 - exp(-w)",
    ", that opens as the piston moves and closes at rest: typical of a gap that dirt fills up at rest",
)  # fmt: skip


def _past(chamber: str, name: str, text: str, formula: str, phrase: str) -> Modulation:
    return Modulation(
        name, f"{{}} {text}, w' = (p_{chamber} - w) / time", formula, phrase, f"pressure_{chamber}", "Pa", 1e6, 1.0,
        Element("lag", f"pressure_{chamber}"), LAG,
    )  # fmt: skip


STORING = {
    f"pressure_{chamber}": _past(
        chamber, f"while {chamber.upper()} rises", f"(p_{chamber} - w)", f"p_{chamber} - w",
        ", as long as the pressure rises: typical of a hose or a bladder whose give changes with its pressure")
    for chamber in "ab"
}  # fmt: skip
"""What a chamber goes on taking after its pressure has risen."""
RISING = tuple(
    _past(chamber, f"while {chamber.upper()} is above its past", f"max(p_{chamber} - w, 0)",
          f"max(p_{chamber} - w, 0.0)",
          f", after the pressure of chamber {chamber.upper()} has risen: typical of a lip that it presses on until its "
          "plastic has flowed")
    for chamber in "ab"
)  # fmt: skip

# --- in proportion to another signal ----------------------------------------------------------------------------------


def _times(text: str, formula: str, unit: str, scale: float, uses: str, cause: str) -> Modulation:
    return Modulation(f"times {text}", f"{{}} {text}", formula, f", in proportion to {cause}", uses, unit, scale, 1.0)


BY_BEND = _times("|x - x_rest|", "abs(x - x_rest)", "m", 1e-2, "position",
                 "the load's deflection: typical of parts that it tilts")  # fmt: skip
BY_STROKE = _times("(x/L - 1/2)", "x / L - 0.5", "-", 0.3, "position",
                   "the place on the stroke: typical of a gap that widens")  # fmt: skip
BY_PLACE = _times("(x - x_rest)", "x - x_rest", "m", 1e-2, "position",
                  "the load's deflection: typical of a body that is bent along")  # fmt: skip
BY_P_A = _times("p_a", "p_a", "Pa", 5e6, "pressure_a",
                "the pressure of chamber A: typical of parts that it presses on")  # fmt: skip
BY_P_B = _times("p_b", "p_b", "Pa", 5e6, "pressure_b",
                "the pressure of chamber B: typical of parts that it presses on")  # fmt: skip
BY_ACROSS = _times("|p_a - p_b|", "abs(across)", "Pa", 3e6, "pressure_a pressure_b",
                   "the pressure across the piston: typical of parts under it")  # fmt: skip
BY_SPEED = _times("|v|", "abs(v)", "m/s", 0.05, "velocity",
                  "the speed: typical of a gap or a lip that motion opens")  # fmt: skip
BY_OPENING = _times("|u|", "abs(u)", "A", 2e-3, "current",
                    "the valve's opening: typical of parts that share its flow or supply")  # fmt: skip
BY_CURRENT = _times("u", "u", "A", 2e-3, "current", "the valve's current: typical of a shared ground")

# --- what a sensor's reading does with its own signal, times 1 --------------------------------------------------------


def of_reading(channel: str, symbol: str, formula: str, unit: str, paths: tuple[float, ...],
               *levels: float) -> tuple[Modulation, ...]:  # fmt: skip
    """By the path of its signal, beyond a threshold, and late; of the position by its path alone.

    `channel`, `symbol`, `formula`, `unit`: the reading, its signal in a text and in a formula, and its unit. `paths`,
    `levels`: start values [unit] of the path of its hysteresis, and of a threshold.
    """
    own = {"f": "force", "x": "position"}.get(formula, channel)
    moved = "(v - |v| w)" if formula == "x" else f"({symbol}' - |{symbol}'| w)"
    hysteresis = Modulation(
        "with hysteresis", f"{{}} w, w' = {moved} / path", "w",
        ", by another path up than down: typical of play, or of a body that rubs in its seat",
        "position velocity" if formula == "x" else channel, element=Element("path", own), numbers=path(unit, *paths),
    )  # fmt: skip
    if not levels:
        return (hysteresis,)
    limits, scale = threshold(channel, unit, *levels), levels[-1]
    return (
        hysteresis,
        Modulation("above a limit", f"{{}} max({symbol} - threshold, 0)", f"max({formula} - threshold, 0.0)",
                   " beyond a limit: typical of an amplifier that saturates, or a body that meets a stop",
                   channel, unit, scale, 1.0, numbers=limits),
        Modulation("below a limit", f"{{}} max(threshold - {symbol}, 0)", f"max(threshold - {formula}, 0.0)",
                   " below a limit: typical of an amplifier that saturates, or a body that comes loose",
                   channel, unit, scale, 1.0, numbers=limits),
        Modulation("that creeps", f"{{}} w, w' = ({symbol} - w) / time", "w",
                   ", and goes on rising under a signal that stays: typical of a body that creeps",
                   channel, unit, scale, 1.0, Element("lag", own), LAG),
    )  # fmt: skip


def of_sides(channel: str, symbol: str) -> tuple[Modulation, ...]:
    """What a cell's reading does in tension and in compression, and beyond and within an amount either way."""
    limits = (Number("threshold", "N", (20.0, 60.0, 150.0)),)

    def made(name: str, text: str, formula: str, phrase: str, side: float = 0.0) -> Modulation:
        return Modulation(name, f"{{}} {text}", formula, f" {phrase}", channel, "N", 100.0, 1.0,
                          numbers=() if side else limits, gate=(channel, side) if side else None)  # fmt: skip

    joint = "alone: typical of a joint that passes part of the force by the cell"
    return (
        made("in push", f"max({symbol}, 0)", "max(f, 0.0)", f"in compression {joint}", 1.0),
        made("in pull", f"-max(-{symbol}, 0)", "-max(-f, 0.0)", f"in tension {joint}", -1.0),
        made("beyond a span", f"sign({symbol}) max(|{symbol}| - threshold, 0)",
             "max(f - threshold, 0.0) - max(-f - threshold, 0.0)",
             "beyond an amount either way: typical of an amplifier that saturates"),
        made("within a span", f"sign({symbol}) min(|{symbol}|, threshold)", "within(f, threshold)",
             "up to an amount either way: typical of a cell that sits down in its seat"),
    )  # fmt: skip


BENT = (
    Modulation("along a curve", "{} (x/L - 1/2)^2", "(x / L - 0.5) * (x / L - 0.5)",
               ", by a curve along the stroke: typical of a transducer that is not straight", "position", scale=0.1,
               degree=2.0),
    Modulation("along an odd curve", "{} (x/L - 1/2)^3", "(x / L - 0.5) * (x / L - 0.5) * (x / L - 0.5)",
               ", by a curve along the stroke: typical of a transducer that is not straight", "position", scale=0.1,
               degree=3.0),
)  # fmt: skip
