# SPDX-License-Identifier: Apache-2.0
"""Whether a law that was found has the form that its kind's right form was fixed as.

What a right form is was fixed in `kinds`, blind; here the texts of the grammar's laws are read in those words: what a
law depends on, and its degree. Laws that have names are listed, which a test holds against the grammar; compositions
say it themselves: the signals of carrier and modulation, the powers of those that multiply, and a state, unless it
hangs on time alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from benchmarks.beyond_the_table.kinds import Kind
from hydro_sim.model.grammar import COMPOSITIONS
from hydro_sim.model.laws import REVERSING, Law


class Form(NamedTuple):
    """What a law depends on, the total power of the signals in it (a sign counts none), and whether it has a state."""

    variables: frozenset[str]
    degree: float
    memory: bool = False


def _form(variables: str, degree: float, *, memory: bool = False) -> Form:
    return Form(frozenset(variables.split()), degree, memory)


_NAMED: dict[Form, tuple[str, ...]] = {
    _form("velocity", 2.0): ("v |v|", "v^2", "max(v, 0)^2", "-max(-v, 0)^2"),
    _form("position", 1.0): ("(x - x_rest) / sqrt(1 + ((x - x_rest) / level)^2)",
        "(x - x_rest) / (1 - (x - x_rest) / gap)", "|x - x_rest|", "max(x - threshold, 0)", "-max(threshold - x, 0)"),
    _form("velocity", 1.0, memory=True): ("max(v - w, 0), w' = (v - w) / (rising or falling)",
        "-max(w - v, 0), w' = (v - w) / (rising or falling)", "(v - w), w' = (v - w) / time",
        "v exp(-w), w' = |v| / path - w / time"),
    _form("velocity", 3.0): ("v^3",),
    _form("velocity", 0.5): ("sign(v) sqrt(|v|)",),
    _form("position velocity", 1.0): ("sign(v) (x/L - 1/2)",),
    _form("position velocity", 2.0): ("v (x/L - 1/2)", "v max(x - threshold, 0)", "v max(threshold - x, 0)"),
    _form("position velocity", 3.0): ("v (x/L - 1/2)^2",),
    _form("pressure_a pressure_b velocity", 1.0): ("sign(v) (p_a + p_b)/2", "sign(v) |p_a - p_b|",
        "(p_a - p_b) where v > 0", "(p_a - p_b) where v < 0"),
    _form("pressure_a pressure_b position", 2.0): ("(p_a - p_b) (x/L - 1/2)",),
    _form("pressure_a pressure_b", 2.0): ("(p_a - p_b) |p_a - p_b|",),
    _form("pressure_a", 2.0): ("p_a^2",),
    _form("pressure_b", 2.0): ("p_b^2",),
    _form("current", 1.0): ("sign(u) min(|u|, threshold)", "(u - u / sqrt(1 + (u / level)^2))",
        "sign(u) max(|u| - threshold, 0)"),
    _form("velocity", 1.0): ("v / (1 + (v / level)^2)", "v min(1, threshold / |v|)",
        "sign(v) max(|v| - threshold, 0)"),
    _form("current", 2.0): ("u |u|",),
    _form("current", 3.0): ("u^3",),
    _form("position", 2.0): ("(x - x_rest) |x - x_rest|",),
    _form("pressure_a", 1.0, memory=True): ("(p_a - w), w' = (p_a - w) / time",
        "w, w' = (max(p_a - threshold, 0) - w) / time", "w', w' = (p_a - w) / (rising or falling)",
        "(w - p_a), w' = (p_a - w) / (rising or falling)"),
    _form("pressure_b", 1.0, memory=True): ("(p_b - w), w' = (p_b - w) / time",
        "w, w' = (max(p_b - threshold, 0) - w) / time", "w', w' = (p_b - w) / (rising or falling)",
        "(w - p_b), w' = (p_b - w) / (rising or falling)"),
    _form("current", 1.0, memory=True): ("w, w' = (u' - |u'| w) / path",
        "(w - u), w' = (u - w) / time within +-rate", "(w - u), w' = (u - w) / time",
        "(w - u), w' = (u - w) / (rising or falling)"),
    _form("position velocity", 1.0, memory=True): ("w, w' = (v - |v| w) / path",),
    _form("position", 1.0, memory=True): ("(x - w), w' = (x - w) / time", "(w - x_rest), w' = (x - w) / time"),
    _form("hydraulic_force", 1.0, memory=True): ("w, w' = (f_h - w) / time",),
    _form("pressure_a velocity", 1.0): ("sign(v) p_a",),
    _form("pressure_b velocity", 1.0): ("sign(v) p_b", "p_b where v > 0", "p_b where v < 0"),
    _form("velocity", 0.0, memory=True): ("sign(v) exp(-w), w' = |v| / path - w / time",),
    _form("pressure_a pressure_b", 1.0): ("max(p_a - p_b, 0)", "-max(p_b - p_a, 0)", "max(p_a - p_b - threshold, 0)",
        "-max(threshold - (p_a - p_b), 0)"),
    _form("pressure_a", 1.0): ("max(p_a - threshold, 0)",),
    _form("pressure_b", 1.0): ("max(p_b - threshold, 0)",),
    _form("current pressure_a pressure_b time", 0.5): ("q (1 - exp(-t / time)) / (2 dp) from the supply",),
    _form("current pressure_a pressure_b", 1.0): ("q (1 - sqrt(|dp| / (|dp| + transition)))",),
    _form("current pressure_a pressure_b", 2.5): ("q |dp|",),
    _form("hydraulic_force", 2.0): ("f_h^2", "f_h |f_h|"),
    _form("hydraulic_force", 3.0): ("f_h^3",),
    _form("load_force", 2.0): ("f_l^2", "f_l |f_l|"),
    _form("load_force", 3.0): ("f_l^3",),
}  # fmt: skip
TEXTS = {text: form for form, texts in _NAMED.items() for text in texts}
"""By the text of a law that has a name."""


def _composition(law: Law) -> Form:
    signals = {law.where if one == "force" else one for one in law.uses}
    return Form(frozenset(signals), law.degree, law.element is not None and law.element.signal != "time")


FORMS = {**{law.text: _composition(law) for law in COMPOSITIONS}, **TEXTS}
"""By the text of a law."""


def right_form(kind: Kind, closure: Mapping[str, Any]) -> bool:
    """Whether an entry of `closures` is a law that depends on what it should, with the right power, or with memory."""
    if closure["form"] != "law" or closure["equation"] not in places(kind):
        return False
    text = closure["expression"].partition(" * ")[2].replace(f", {REVERSING}", "")
    form = next((form for known, form in FORMS.items() if text == known or text.startswith(f"{known}, ")), None)
    if form is None or form.variables != kind.variables or form.memory != kind.memory:
        return False
    return kind.degree is None or form.degree == kind.degree


def places(kind: Kind) -> frozenset[str]:
    """Ids of `closures.equation` that are right; `pressure` is both chambers'."""
    both = {"pressure_a", "pressure_b"} <= set(kind.equations)
    return frozenset(kind.equations) | ({"pressure"} if both else set())
