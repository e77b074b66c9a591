# SPDX-License-Identifier: Apache-2.0
"""Laws of the forces: against the motion, and of the load."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol
from hydro_sim.model.grammar.words import LAG, PLACE, above, creep, deflection, middle, path, threshold, within
from hydro_sim.model.law_signals import Signals
from hydro_sim.model.laws import Element, Law, Number

_TURNS = (Number("rising", "s", (0.03, 0.1, 0.3, 1.0)), Number("falling", "s", (0.03, 0.1, 0.3, 1.0)))
_FOLLOWS = "w' = (v - w) / (rising or falling)"
_AHEAD: tuple[tuple[str, str, Callable[[Signals, Any], Symbol]], ...] = (
    ("outwards", f"max(v - w, 0), {_FOLLOWS}", lambda at, n: above(at.velocity, at.memory)),
    ("inwards", f"-max(w - v, 0), {_FOLLOWS}", lambda at, n: -above(at.memory, at.velocity)),
)
_HEAT = (Number("path", "m", (3e-3, 1e-2, 0.1, 0.3, 1.0, 3.0)), Number("time", "s", (0.05, 0.2, 3.0, 10.0, 30.0)))
LAWS: tuple[Law, ...] = (
    Law("motion", "quadratic drag", "N s2/m2", "v |v|",
        "Force against motion that grows with the square of speed: typical of oil forced through a port.",
        100.0, lambda at, n: at.velocity * np.abs(at.velocity)),
    Law("motion", "cubic drag", "N s3/m3", "v^3",
        "Force against motion that grows with the cube of speed: typical of a choked port.",
        1000.0, lambda at, n: at.velocity * at.velocity * at.velocity),
    Law("motion", "root drag", "N sqrt(s/m)", "sign(v) sqrt(|v|)",
        "Force against motion that levels off with speed: typical of seals whose oil film grows.",
        10.0, lambda at, n: at.velocity / np.sqrt(np.abs(at.velocity) + at.turn)),
    Law("motion", "friction along the stroke", "N", "sign(v) (x/L - 1/2)",
        "Dry friction that changes along the stroke: typical of a rod that is bent or a bore that is worn.",
        20.0, lambda at, n: at.direction * middle(at, n)),
    Law("motion", "drag along the stroke", "N s/m", "v (x/L - 1/2)",
        "Viscous friction that changes along the stroke: typical of a gap that is not even.",
        100.0, lambda at, n: at.velocity * middle(at, n)),
    Law("motion", "drag off the middle", "N s/m", "v (x/L - 1/2)^2",
        "Viscous friction that grows to either side of the middle: typical of a bore that narrows towards its ends.",
        500.0, lambda at, n: at.velocity * middle(at, n) * middle(at, n)),
    Law("motion", "friction by pressure", "N/Pa", "sign(v) (p_a + p_b)/2",
        "Dry friction that grows with pressure: typical of seals that pressure presses on.",
        1e-6, lambda at, n: at.direction * 0.5 * (at.pressure_a + at.pressure_b)),
    Law("motion", "friction by pressure difference", "N/Pa", "sign(v) |p_a - p_b|",
        "Dry friction that grows with the pressure across the piston: typical of a piston seal.",
        1e-6, lambda at, n: at.direction * np.abs(at.pressure_difference)),
    Law("load", "quadratic spring", "N/m2", "(x - x_rest) |x - x_rest|",
        "Load whose stiffness changes with its deflection: typical of a contact that grows.",
        1e5, lambda at, n: deflection(at, n) * np.abs(deflection(at, n))),
    Law("load", "lopsided spring", "N/m", "|x - x_rest|",
        "Load that is stiffer on one side of its rest: typical of a second spring or a preload that opens.",
        100.0, lambda at, n: np.abs(deflection(at, n))),
    Law("load", "hysteresis", "N", "w, w' = (v - |v| w) / path",
        "Load that follows another path back than forth: typical of rubber, a leaf spring or a joint that rubs.",
        5.0, lambda at, n: at.memory, Element("path", "position"), path("m", 3e-4, 1e-3, 3e-3, 1e-2)),
    Law("load", "creeping spring", "N/m", "(x - w), w' = (x - w) / time",
        "Load that relaxes where it is held: typical of rubber or plastic in the load's way.",
        1e3, lambda at, n: at.position - at.memory, creep("position"), LAG),
    Law("motion", "creeping stiffness", "N/m", "(x - w), w' = (x - w) / time",
        "Force against motion that relaxes where the piston is held: typical of a bellows that breathes by a small "
        "hole, or rubber along the rod.",
        1e3, lambda at, n: at.position - at.memory, creep("position"), LAG),
    Law("motion", "fading drag", "N s/m", "(v - w), w' = (v - w) / time",
        "Force against motion that fades where the motion goes on: typical of oil that is dragged along.",
        50.0, lambda at, n: at.velocity - (at.position - at.memory) / at.number, creep("position"), LAG),
    *(Law(equation, "even drag", "N s2/m2", "v^2",
          f"{whose} that grows with the square of speed and points the same way whichever way it moves: typical of "
          "flyweights, or of a jet.",
          100.0, lambda at, n: at.velocity * at.velocity)
      for equation, whose in (("motion", "Force on the piston"), ("load", "Force of the load"))),
    *(Law(equation, "rounded stiffness", "N/m", "(x - x_rest) / sqrt(1 + ((x - x_rest) / level)^2)",
          f"{whose} that grows ever less with the deflection: typical of a wire or a magnet that lets go.",
          1e3, lambda at, n: deflection(at, n) / np.sqrt(1.0 + (deflection(at, n) / at.number) ** 2),
          numbers=(Number("level", "m", (1e-3, 2e-3, 4e-3, 8e-3, 1.6e-2)),))
      for equation, whose in (("motion", "Force beside the load"), ("load", "Force of the load"))),
    *(Law(equation, f"speed ahead {way}", "N s/m", text, f"{whose} speed gets ahead of itself {way}, and that fades "
          "where it stays: typical of a flywheel behind a freewheel that slips.",
          50.0, shape, Element("turn", "velocity"), _TURNS)
      for equation, whose in (("motion", "Force against motion while its"), ("load", "Force of the load while its"))
      for way, text, shape in _AHEAD),
    *(Law(equation, "late stiffness", "N/m", "(w - x_rest), w' = (x - w) / time",
          f"{whose} of which a part follows the position late: typical of a mount or a joint that gives slowly.",
          100.0, lambda at, n: at.memory - n.spring_rest_position, creep("position"), LAG)
      for equation, whose in (("load", "A stiffness of the load"), ("motion", "A stiffness beside the load"))),
    Law("motion", "drag outwards", "N s2/m2", "max(v, 0)^2",
        "Force against outward motion that grows with the square of speed: typical of a throttle with a check valve.",
        100.0, lambda at, n: np.fmax(at.velocity, 0.0) * np.fmax(at.velocity, 0.0)),
    Law("motion", "drag inwards", "N s2/m2", "-max(-v, 0)^2",
        "Force against inward motion that grows with the square of speed: typical of a throttle with a check valve.",
        100.0, lambda at, n: -np.fmax(-at.velocity, 0.0) * np.fmax(-at.velocity, 0.0)),
    Law("motion", "friction by pressure of A", "N/Pa", "sign(v) p_a",
        "Dry friction that grows with the pressure of chamber A: typical of a piston seal that lifts the other way.",
        1e-6, lambda at, n: at.direction * at.pressure_a),
    Law("motion", "friction by pressure of B", "N/Pa", "sign(v) p_b",
        "Dry friction that grows with the pressure of chamber B: typical of the rod's seal.",
        1e-6, lambda at, n: at.direction * at.pressure_b),
    Law("motion", "drag above a speed", "N s/m", "sign(v) max(|v| - threshold, 0)",
        "Force against motion that begins at a speed: typical of a port that chokes or a valve that shuts.",
        50.0, lambda at, n: at.direction * above(at.speed, at.number),
        numbers=threshold("speed", "m/s", 0.01, 0.03, 0.06, 0.1, 0.2)),
    Law("motion", "drag up to a speed", "N s/m", "v min(1, threshold / |v|)",
        "Force against motion that grows up to a speed alone: typical of a throttle that a relief valve by-passes.",
        50.0, lambda at, n: within(at.velocity, at.number),
        numbers=threshold("speed", "m/s", 0.01, 0.03, 0.06, 0.1, 0.2)),
    Law("motion", "drag past its peak", "N s/m", "v / (1 + (v / level)^2)",
        "Force against motion that grows up to a speed and falls beyond it: typical of eddy currents in a wall.",
        100.0, lambda at, n: at.velocity / (1.0 + (at.velocity / at.number) * (at.velocity / at.number)),
        numbers=(Number("level", "m/s", (0.01, 0.02, 0.04, 0.08, 0.16, 0.3)),)),
    Law("motion", "drag towards the outer end", "N s/m2", "v max(x - threshold, 0)",
        "Viscous friction that begins at a place: typical of a throttle that closes towards the end of the stroke.",
        1e4, lambda at, n: at.velocity * above(at.position, at.number), numbers=PLACE),
    Law("motion", "drag towards the inner end", "N s/m2", "v max(threshold - x, 0)",
        "Viscous friction that begins at a place: typical of a throttle that closes towards the end of the stroke.",
        1e4, lambda at, n: at.velocity * above(at.number, at.position), numbers=PLACE),
    Law("motion", "warming drag", "N s/m", "v exp(-w), w' = |v| / path - w / time",
        "Viscous friction that fades with motion and returns with rest: typical of oil that thins as it warms.",
        50.0, lambda at, n: at.velocity * np.exp(-at.memory), Element("heat", "position"), _HEAT),
    Law("motion", "warming friction", "N", "sign(v) exp(-w), w' = |v| / path - w / time",
        "Dry friction that fades with motion and returns with rest: typical of seals and grease that warm, or of lips "
        "that squeeze their film out at rest.",
        5.0, lambda at, n: at.direction * np.exp(-at.memory), Element("heat", "position"), _HEAT),
    Law("load", "gas spring", "N/m", "(x - x_rest) / (1 - (x - x_rest) / gap)",
        "Load that grows the faster the less room is left: typical of gas or foam that is compressed.",
        1e3, lambda at, n: deflection(at, n) / np.fmax(1.0 - deflection(at, n) / at.number, 0.05),
        numbers=(Number("gap", "m", (0.02, 0.04, 0.08, 0.16)),)),
    Law("load", "second spring outwards", "N/m", "max(x - threshold, 0)",
        "Load that grows stiffer from a place on: typical of a bumper or a second spring that engages.",
        1e3, lambda at, n: above(at.position, at.number), numbers=PLACE),
    Law("load", "second spring inwards", "N/m", "-max(threshold - x, 0)",
        "Load that grows stiffer below a place: typical of a bumper or a second spring that engages.",
        1e3, lambda at, n: -above(at.number, at.position), numbers=PLACE),
)  # fmt: skip
