# SPDX-License-Identifier: Apache-2.0
"""Modulations by the past: time since the start, the path since a reversal, and what goes on in a sensor."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hydro_sim.model.equations import Symbol
from hydro_sim.model.grammar.modulations import TIMES
from hydro_sim.model.grammar.parts import Modulation
from hydro_sim.model.grammar.words import LAG, above, middle, path, threshold, within
from hydro_sim.model.law_signals import Signals
from hydro_sim.model.laws import Element, Number

FADING = Modulation(
    name="fading from the start", text="{} exp(-t / time)", uses="time",
    phrase=" that fades from the start of a recording: typical of a bench that starts cold",
    factor=lambda at, n: 1.0 - at.memory, element=Element("slow", "time"), numbers=(Number("time", "s", TIMES),),
)  # fmt: skip
_PATH = path("m", 1e-4, 3e-4, 1e-3, 3e-3)
REVERSED = Modulation(
    name="since a reversal", text="{} (1 - w^2), w' = (v - |v| w) / path", uses="velocity",
    phrase=", while the piston turns round: typical of a ring that leaves its seat, or of a film that tears",
    factor=lambda at, n: 1.0 - at.memory * at.memory, element=Element("path", "position"), numbers=_PATH,
)  # fmt: skip
SEATED = Modulation(
    name="beyond a reversal", text="{} w^2, w' = (v - |v| w) / path", uses="velocity",
    phrase=", but while the piston turns round: typical of a ring that seals again once it is dragged along",
    factor=lambda at, n: at.memory * at.memory, element=Element("path", "position"), numbers=_PATH,
)  # fmt: skip
PRESLIDING = Modulation(
    name="with presliding", text="{} w, w' = (v - |v| w) / path", uses="velocity",
    phrase=", that gives a little before it slides: typical of strands, leaves or lips that stick to each other first",
    factor=lambda at, n: at.memory, element=Element("path", "position"), numbers=_PATH,
)  # fmt: skip
_WIPING = (Number("path", "m", (2e-3, 6e-3, 2e-2)), Number("time", "s", (0.05, 0.15, 0.5)))
RESTED = Modulation(
    name="after rest", text="{} exp(-w), w' = |v| / path - w / time", uses="velocity",
    phrase=", that fades as the piston moves and returns at rest: typical of a film that is squeezed out at rest",
    factor=lambda at, n: np.exp(-at.memory), element=Element("heat", "position"), numbers=_WIPING,
)  # fmt: skip
WIPED = Modulation(
    name="after motion", text="{} (1 - exp(-w)), w' = |v| / path - w / time", uses="velocity",
    phrase=", that opens as the piston moves and closes at rest: typical of a gap that dirt fills up at rest",
    factor=lambda at, n: 1.0 - np.exp(-at.memory), element=Element("heat", "position"), numbers=_WIPING,
)  # fmt: skip


def storing(chamber: str, pressure: Callable[[Signals], Symbol]) -> Modulation:
    """What a chamber goes on taking after its pressure has risen."""
    return Modulation(
        name=f"while {chamber.upper()} rises", text=f"{{}} (p_{chamber} - w), w' = (p_{chamber} - w) / time",
        uses=f"pressure_{chamber}", degree=1.0, unit="Pa", scale=1e6, element=Element("lag", f"pressure_{chamber}"),
        phrase=", as long as the pressure rises: typical of a hose or a bladder whose give changes with its pressure",
        factor=lambda at, n: pressure(at) - at.memory, numbers=LAG,
    )  # fmt: skip


STORING = {"pressure_a": storing("a", lambda at: at.pressure_a), "pressure_b": storing("b", lambda at: at.pressure_b)}

RISING = tuple(
    Modulation(
        name=f"while {chamber.upper()} is above its past",
        text=f"{{}} max(p_{chamber} - w, 0), w' = (p_{chamber} - w) / time",
        uses=f"pressure_{chamber}", degree=1.0, unit="Pa", scale=1e6, element=Element("lag", f"pressure_{chamber}"),
        phrase=f", after the pressure of chamber {chamber.upper()} has risen: typical of a lip that it presses on "
        "until its plastic has flowed", factor=factor, numbers=LAG,
    )
    for chamber, factor in (("a", lambda at, n: above(at.pressure_a, at.memory)),
                            ("b", lambda at, n: above(at.pressure_b, at.memory)))
)  # fmt: skip

BENT = tuple(
    Modulation(name=name, text=f"{{}} {text}", uses="position", degree=degree, scale=0.1,
               phrase=", by a curve along the stroke: typical of a transducer that is not straight",
               factor=factor)
    for name, text, degree, factor in (
        ("along a curve", "(x/L - 1/2)^2", 2.0, lambda at, n: middle(at, n) * middle(at, n)),
        ("along an odd curve", "(x/L - 1/2)^3", 3.0, lambda at, n: middle(at, n) * middle(at, n) * middle(at, n)))
)  # fmt: skip


def of_reading(channel: str, own: str, symbol: str, unit: str, paths: tuple[float, ...],
               levels: tuple[float, ...]) -> tuple[Modulation, ...]:  # fmt: skip
    """What a sensor's reading may do with its own signal, times 1.

    Parameters
    ----------
    channel, own, symbol, unit
        The reading, its signal as an attribute of `Signals`, that in a text, and its unit.
    paths, levels
        Start values [unit] of the path of its hysteresis, and of a threshold.
    """
    limits = threshold("position" if own == "position" else channel, unit, *levels)
    uses = "position velocity" if own == "position" else channel
    moved = "w' = (v - |v| w) / path" if own == "position" else f"w' = ({symbol}' - |{symbol}'| w) / path"
    scale = levels[-1] if levels else 1.0
    return (
        Modulation(name="with hysteresis", text=f"{{}} w, {moved}", uses=uses, element=Element("path", own),
                   phrase=", by another path up than down: typical of play, or of a body that rubs in its seat",
                   factor=lambda at, n: at.memory, numbers=path(unit, *paths)),
        Modulation(name="above a limit", text=f"{{}} max({symbol} - threshold, 0)", uses=channel, degree=1.0, unit=unit,
                   phrase=" beyond a limit: typical of an amplifier that saturates, or a body that meets a stop",
                   factor=lambda at, n: above(getattr(at, own), at.number), scale=scale, numbers=limits),
        Modulation(name="below a limit", text=f"{{}} max(threshold - {symbol}, 0)", uses=channel, degree=1.0, unit=unit,
                   phrase=" below a limit: typical of an amplifier that saturates, or a body that comes loose",
                   factor=lambda at, n: above(at.number, getattr(at, own)), scale=scale, numbers=limits),
        Modulation(name="that creeps", text=f"{{}} w, w' = ({symbol} - w) / time", uses=channel, degree=1.0, unit=unit,
                   phrase=", and goes on rising under a signal that stays: typical of a body that creeps",
                   factor=lambda at, n: at.memory, scale=scale, element=Element("lag", own), numbers=LAG),
    )  # fmt: skip


def of_sides(channel: str, symbol: str) -> tuple[Modulation, ...]:
    """What a cell's reading may do in tension and in compression, times 1."""

    def made(name: str, text: str, phrase: str, side: float) -> Modulation:
        return Modulation(name=name, text=f"{{}} {text}", uses=channel, degree=1.0, unit="N", scale=100.0,
                          phrase=f" {phrase} alone: typical of a joint that passes part of the force by the cell",
                          factor=lambda at, n: side * np.fmax(side * at.force, 0.0), gate=(channel, side))  # fmt: skip

    return (made("in push", f"max({symbol}, 0)", "in compression", 1.0),
            made("in pull", f"-max(-{symbol}, 0)", "in tension", -1.0))  # fmt: skip


def both_sides(channel: str, symbol: str, levels: tuple[float, ...]) -> tuple[Modulation, Modulation]:
    """A cell's reading beyond an amount either way, and up to it, times 1."""
    limits = (Number("threshold", "N", levels),)
    return Modulation(
        name="beyond a span", text=f"{{}} sign({symbol}) max(|{symbol}| - threshold, 0)", uses=channel, degree=1.0,
        unit="N", scale=100.0, phrase=" beyond an amount either way: typical of an amplifier that saturates",
        factor=lambda at, n: above(at.force, at.number) - above(-at.force, at.number), numbers=limits,
    ), Modulation(
        name="within a span", text=f"{{}} sign({symbol}) min(|{symbol}|, threshold)", uses=channel, degree=1.0,
        unit="N", scale=100.0, phrase=" up to an amount either way: typical of a cell that sits down in its seat",
        factor=lambda at, n: within(at.force, at.number), numbers=limits,
    )  # fmt: skip
