# SPDX-License-Identifier: Apache-2.0
"""Laws that have names, one row each: of the forces, of the flows beside the valve, of the valve, of the sensors."""

from __future__ import annotations

from hydro_sim.model.grammar.modulations import LAG, LEVELS, PLACE, SPEED, TIMES, path, threshold
from hydro_sim.model.laws import Element, Law, Number


def _turns(*times: float) -> tuple[Number, Number]:
    """One time for rises, one for falls."""
    return Number("rising", "s", times), Number("falling", "s", times)


_AHEAD = (("outwards", "max(v - w, 0)", "max(v - w, 0.0)"), ("inwards", "-max(w - v, 0)", "-max(w - v, 0.0)"))
_HEAT = (Number("path", "m", (3e-3, 1e-2, 0.1, 0.3, 1.0, 3.0)), Number("time", "s", (0.05, 0.2, 3.0, 10.0, 30.0)))
_WARM = Element("heat", "position")
_CREEP = Element("lag", "position")
_FORCES: tuple[Law, ...] = (
    Law("motion", "quadratic drag", "N s2/m2", "v |v|", "v * abs(v)", 100.0,
        "Force against motion that grows with the square of speed: typical of oil forced through a port."),
    Law("motion", "cubic drag", "N s3/m3", "v^3", "v * v * v", 1000.0,
        "Force against motion that grows with the cube of speed: typical of a choked port."),
    Law("motion", "root drag", "N sqrt(s/m)", "sign(v) sqrt(|v|)", "v / sqrt(abs(v) + turn)", 10.0,
        "Force against motion that levels off with speed: typical of seals whose oil film grows."),
    Law("motion", "friction along the stroke", "N", "sign(v) (x/L - 1/2)", "sign_v * (x / L - 0.5)", 20.0,
        "Dry friction that changes along the stroke: typical of a rod that is bent or a bore that is worn."),
    Law("motion", "drag along the stroke", "N s/m", "v (x/L - 1/2)", "v * (x / L - 0.5)", 100.0,
        "Viscous friction that changes along the stroke: typical of a gap that is not even."),
    Law("motion", "drag off the middle", "N s/m", "v (x/L - 1/2)^2", "v * (x / L - 0.5) * (x / L - 0.5)", 500.0,
        "Viscous friction that grows to either side of the middle: typical of a bore that narrows towards its ends."),
    Law("motion", "friction by pressure", "N/Pa", "sign(v) (p_a + p_b)/2", "sign_v * 0.5 * (p_a + p_b)", 1e-6,
        "Dry friction that grows with pressure: typical of seals that pressure presses on."),
    Law("motion", "friction by pressure difference", "N/Pa", "sign(v) |p_a - p_b|", "sign_v * abs(across)", 1e-6,
        "Dry friction that grows with the pressure across the piston: typical of a piston seal."),
    Law("load", "quadratic spring", "N/m2", "(x - x_rest) |x - x_rest|", "(x - x_rest) * abs(x - x_rest)", 1e5,
        "Load whose stiffness changes with its deflection: typical of a contact that grows."),
    Law("load", "lopsided spring", "N/m", "|x - x_rest|", "abs(x - x_rest)", 100.0,
        "Load that is stiffer on one side of its rest: typical of a second spring or a preload that opens."),
    Law("load", "hysteresis", "N", "w, w' = (v - |v| w) / path", "w", 5.0,
        "Load that follows another path back than forth: typical of rubber, a leaf spring or a joint that rubs.",
        Element("path", "position"), path("m", 3e-4, 1e-3, 3e-3, 1e-2)),
    Law("load", "creeping spring", "N/m", "(x - w), w' = (x - w) / time", "x - w", 1e3,
        "Load that relaxes where it is held: typical of rubber or plastic in the load's way.", _CREEP, LAG),
    Law("motion", "creeping stiffness", "N/m", "(x - w), w' = (x - w) / time", "x - w", 1e3,
        "Force against motion that relaxes where the piston is held: typical of a bellows that breathes by a small "
        "hole, or rubber along the rod.", _CREEP, LAG),
    Law("motion", "fading drag", "N s/m", "(v - w), w' = (v - w) / time", "v - (x - w) / time", 50.0,
        "Force against motion that fades where the motion goes on: typical of oil that is dragged along.", _CREEP, LAG),
    *(Law(equation, "even drag", "N s2/m2", "v^2", "v * v", 100.0,
          f"{whose} that grows with the square of speed and points the same way whichever way it moves: typical of "
          "flyweights, or of a jet.")
      for equation, whose in (("motion", "Force on the piston"), ("load", "Force of the load"))),
    *(Law(equation, "rounded stiffness", "N/m", "(x - x_rest) / sqrt(1 + ((x - x_rest) / level)^2)",
          "(x - x_rest) / sqrt(1.0 + ((x - x_rest) / level) ** 2)", 1e3,
          f"{whose} that grows ever less with the deflection: typical of a wire or a magnet that lets go.",
          numbers=(Number("level", "m", (1e-3, 2e-3, 4e-3, 8e-3, 1.6e-2)),))
      for equation, whose in (("motion", "Force beside the load"), ("load", "Force of the load"))),
    *(Law(equation, f"speed ahead {way}", "N s/m", f"{text}, w' = (v - w) / (rising or falling)", formula, 50.0,
          f"{whose} speed gets ahead of itself {way}, and that fades where it stays: typical of a flywheel behind a "
          "freewheel that slips.", Element("turn", "velocity"), _turns(0.03, 0.1, 0.3, 1.0))
      for equation, whose in (("motion", "Force against motion while its"), ("load", "Force of the load while its"))
      for way, text, formula in _AHEAD),
    *(Law(equation, "late stiffness", "N/m", "(w - x_rest), w' = (x - w) / time", "w - x_rest", 100.0,
          f"{whose} of which a part follows the position late: typical of a mount or a joint that gives slowly.",
          _CREEP, LAG)
      for equation, whose in (("load", "A stiffness of the load"), ("motion", "A stiffness beside the load"))),
    Law("motion", "drag outwards", "N s2/m2", "max(v, 0)^2", "max(v, 0.0) * max(v, 0.0)", 100.0,
        "Force against outward motion that grows with the square of speed: typical of a throttle with a check valve."),
    Law("motion", "drag inwards", "N s2/m2", "-max(-v, 0)^2", "-max(-v, 0.0) * max(-v, 0.0)", 100.0,
        "Force against inward motion that grows with the square of speed: typical of a throttle with a check valve."),
    Law("motion", "friction by pressure of A", "N/Pa", "sign(v) p_a", "sign_v * p_a", 1e-6,
        "Dry friction that grows with the pressure of chamber A: typical of a piston seal that lifts the other way."),
    Law("motion", "friction by pressure of B", "N/Pa", "sign(v) p_b", "sign_v * p_b", 1e-6,
        "Dry friction that grows with the pressure of chamber B: typical of the rod's seal."),
    Law("motion", "drag above a speed", "N s/m", "sign(v) max(|v| - threshold, 0)",
        "sign_v * max(abs(v) - threshold, 0.0)", 50.0,
        "Force against motion that begins at a speed: typical of a port that chokes or a valve that shuts.",
        numbers=SPEED),
    Law("motion", "drag up to a speed", "N s/m", "v min(1, threshold / |v|)", "within(v, threshold)", 50.0,
        "Force against motion that grows up to a speed alone: typical of a throttle that a relief valve by-passes.",
        numbers=SPEED),
    Law("motion", "drag past its peak", "N s/m", "v / (1 + (v / level)^2)",
        "v / (1.0 + (v / level) * (v / level))", 100.0,
        "Force against motion that grows up to a speed and falls beyond it: typical of eddy currents in a wall.",
        numbers=(Number("level", "m/s", (0.01, 0.02, 0.04, 0.08, 0.16, 0.3)),)),
    Law("motion", "drag towards the outer end", "N s/m2", "v max(x - threshold, 0)", "v * max(x - threshold, 0.0)", 1e4,
        "Viscous friction that begins at a place: typical of a throttle that closes towards the end of the stroke.",
        numbers=PLACE),
    Law("motion", "drag towards the inner end", "N s/m2", "v max(threshold - x, 0)", "v * max(threshold - x, 0.0)", 1e4,
        "Viscous friction that begins at a place: typical of a throttle that closes towards the end of the stroke.",
        numbers=PLACE),
    Law("motion", "warming drag", "N s/m", "v exp(-w), w' = |v| / path - w / time", "v * exp(-w)", 50.0,
        "Viscous friction that fades with motion and returns with rest: typical of oil that thins as it warms.",
        _WARM, _HEAT),
    Law("motion", "warming friction", "N", "sign(v) exp(-w), w' = |v| / path - w / time", "sign_v * exp(-w)", 5.0,
        "Dry friction that fades with motion and returns with rest: typical of seals and grease that warm, or of lips "
        "that squeeze their film out at rest.", _WARM, _HEAT),
    Law("load", "gas spring", "N/m", "(x - x_rest) / (1 - (x - x_rest) / gap)",
        "(x - x_rest) / max(1.0 - (x - x_rest) / gap, 0.05)", 1e3,
        "Load that grows the faster the less room is left: typical of gas or foam that is compressed.",
        numbers=(Number("gap", "m", (0.02, 0.04, 0.08, 0.16)),)),
    Law("load", "second spring outwards", "N/m", "max(x - threshold, 0)", "max(x - threshold, 0.0)", 1e3,
        "Load that grows stiffer from a place on: typical of a bumper or a second spring that engages.", numbers=PLACE),
    Law("load", "second spring inwards", "N/m", "-max(threshold - x, 0)", "-max(threshold - x, 0.0)", 1e3,
        "Load that grows stiffer below a place: typical of a bumper or a second spring that engages.", numbers=PLACE),
)  # fmt: skip

_ACROSS = threshold("pressure_difference", "Pa", -3e6, -1e6, 3e5, 1e6, 3e6)
_GROWS = "that grows faster than the pressure: typical of a seal lip that lifts."
_ONE_WAY = "typical of a seal lip that opens one way."
_WORN = "typical of a rod seal that is worn on one side."
_FLOWS: tuple[Law, ...] = (
    Law("pressure", "leak along the stroke", "m3/s/Pa", "(p_a - p_b) (x/L - 1/2)", "across * (x / L - 0.5)", 1e-13,
        "A leak between the chambers that changes along the stroke: typical of a gap whose width changes along the "
        "stroke: a bore that is worn or a tube that widens."),
    Law("pressure", "quadratic leak", "m3/s/Pa2", "(p_a - p_b) |p_a - p_b|", "across * abs(across)", 1e-20,
        f"A leak between the chambers {_GROWS}"),
    *(law for chamber in "ab" for law in (
        Law(f"pressure_{chamber}", "creeping volume", "m3/s/Pa", f"(p_{chamber} - w), w' = (p_{chamber} - w) / time",
            f"p_{chamber} - w", 1e-13, f"Chamber {chamber.upper()} goes on taking oil after its pressure has risen: "
            "typical of a hose that creeps.", Element("lag", f"pressure_{chamber}"), LAG),
        Law(f"pressure_{chamber}", "quadratic leak", "m3/s/Pa2", f"p_{chamber}^2", f"p_{chamber} * p_{chamber}", 1e-20,
            f"A leak of chamber {chamber.upper()} {_GROWS}"))),
    Law("pressure", "leak while moving out", "m3/s/Pa", "(p_a - p_b) where v > 0", "across * max(sign_v, 0.0)", 1e-13,
        f"A leak between the chambers in outward motion alone: {_ONE_WAY}"),
    Law("pressure", "leak while moving in", "m3/s/Pa", "(p_a - p_b) where v < 0", "across * max(-sign_v, 0.0)", 1e-13,
        f"A leak between the chambers in inward motion alone: {_ONE_WAY}"),
    Law("pressure", "check valve from A to B", "m3/s/Pa", "max(p_a - p_b, 0)", "max(across, 0.0)", 1e-13,
        "A leak from chamber A to B, not back: typical of a seal lip or a check valve that opens one way."),
    Law("pressure", "check valve from B to A", "m3/s/Pa", "-max(p_b - p_a, 0)", "-max(-across, 0.0)", 1e-13,
        "A leak from chamber B to A, not back: typical of a seal lip or a check valve that opens one way."),
    Law("pressure", "relief from A to B", "m3/s/Pa", "max(p_a - p_b - threshold, 0)", "max(across - threshold, 0.0)",
        1e-13, "Flow from chamber A to B above a pressure difference: typical of a cross-port relief valve.",
        numbers=_ACROSS),
    Law("pressure", "relief from B to A", "m3/s/Pa", "-max(threshold - (p_a - p_b), 0)",
        "-max(threshold - across, 0.0)", 1e-13,
        "Flow from chamber B to A above a pressure difference: typical of a cross-port relief valve.", numbers=_ACROSS),
    *(Law(f"pressure_{chamber}", "relief", "m3/s/Pa", f"max(p_{chamber} - threshold, 0)",
          f"max(p_{chamber} - threshold, 0.0)", 1e-13,
          f"Chamber {chamber.upper()} loses oil above a pressure: typical of a relief valve.",
          numbers=threshold(f"pressure_{chamber}", "Pa", *LEVELS))
      for chamber in "ab"),
    *(Law(f"pressure_{chamber}", "pocket", "m3/Pa", f"w', w' = (p_{chamber} - w) / (rising or falling)",
          f"max(p_{chamber} - w, 0.0) / rising - max(w - p_{chamber}, 0.0) / falling", 1e-14,
          f"Chamber {chamber.upper()} fills a volume that gives its oil back at another rate: typical of a pocket "
          "behind a lip that lets oil in only.", Element("turn", f"pressure_{chamber}"), _turns(0.01, 0.03, 0.1, 0.3))
      for chamber in "ab"),
    *(Law(f"pressure_{chamber}", "late relief", "m3/s/Pa", f"w, w' = (max(p_{chamber} - threshold, 0) - w) / time", "w",
          1e-13, f"Chamber {chamber.upper()} loses oil above a pressure, late: typical of a relief valve whose poppet "
          "lags.", Element("slow", f"over_{chamber}"),
          (*threshold(f"pressure_{chamber}", "Pa", *LEVELS), Number("time", "s", (0.01, 0.03, 0.1, 0.3))))
      for chamber in "ab"),
    Law("pressure_b", "leak while moving out", "m3/s/Pa", "p_b where v > 0", "p_b * max(sign_v, 0.0)", 1e-13,
        f"Chamber B loses oil while the rod moves out: {_WORN}"),
    Law("pressure_b", "leak while moving in", "m3/s/Pa", "p_b where v < 0", "p_b * max(-sign_v, 0.0)", 1e-13,
        f"Chamber B loses oil while the rod moves in: {_WORN}"),
)  # fmt: skip

_OPENING = threshold("opening", "A", 3e-4, 1e-3, 2e-3, 4e-3, 8e-3)
_LATE = Number("time", "s", (2e-4, 1e-3, 5e-3))
_VALVE: tuple[Law, ...] = (
    Law("actuation", "quadratic gain", "1/A", "u |u|", "u * abs(u)", 1.0,
        "Flow that is not proportional to the current: typical of edges with round ports."),
    Law("actuation", "cubic gain", "1/A2", "u^3", "u * u * u", 100.0,
        "Flow that saturates or grows with the current: typical of a torque motor near its limit."),
    Law("actuation", "hysteresis", "A", "w, w' = (u' - |u'| w) / path", "w", 2e-4,
        "Flow that follows another path up than down: typical of a torque motor whose iron stays magnetic.",
        Element("path", "current"), path("A", 1e-4, 3e-4, 1e-3, 3e-3)),
    Law("actuation", "saturation", "-", "sign(u) max(|u| - threshold, 0)",
        "max(u - threshold, 0.0) - max(-u - threshold, 0.0)", 0.05,
        "The valve's gain is another beyond an opening: typical of ports of two widths, or a torque motor "
        "near its limit.", numbers=_OPENING),
    Law("actuation", "gain near null", "-", "sign(u) min(|u|, threshold)", "within(u, threshold)", 0.05,
        "The valve's gain is another up to an opening: typical of notches in the lands.", numbers=_OPENING),
    Law("actuation", "rounded gain", "-", "(u - u / sqrt(1 + (u / level)^2))",
        "u - u / sqrt(1.0 + (u / level) * (u / level))", 0.3,
        "Flow that grows ever less with the current: typical of a torque motor whose iron saturates; -1: all of it.",
        numbers=(Number("level", "A", (2e-3, 5e-3, 1e-2, 2e-2, 5e-2)),)),
    Law("actuation", "rate limit", "-", "(w - u), w' = (u - w) / time within +-rate", "w - u", 1.0,
        "A spool that lags, and moves no faster than a rate: typical of a pilot stage that saturates; 1: all of it.",
        Element("rate", "current"), (Number("rate", "A/s", (0.03, 0.1, 0.3, 1.0)), _LATE)),
    Law("actuation", "late share", "-", "(w - u), w' = (u - w) / time", "w - u", 0.1,
        "A share of the opening that comes late: typical of eddies in a torque motor's iron, or of a spool that "
        "creeps; 1: all of it.", Element("lag", "current"), (Number("time", "s", (0.01, 0.03, 0.1, 0.3, 1.0)),)),
    Law("actuation", "rises and falls", "-", "(w - u), w' = (u - w) / (rising or falling)", "w - u", 1.0,
        "A spool that follows rises and falls at different rates: typical of a pilot stage of which one nozzle is half "
        "clogged; 1: all of it.", Element("turn", "current"), _turns(3e-4, 1e-3, 4e-3)),
    Law("actuation", "falling supply", "Pa", "q (1 - exp(-t / time)) / (2 dp) from the supply",
        "0.5 * feeds * w / max(abs(drop), 0.05 * p_s)", 5e5,
        "Edges that are fed by a pressure that falls from the start: typical of a pump's relief valve that sets down "
        "as it warms, or an accumulator that empties.", Element("slow", "time"), (Number("time", "s", TIMES),), "edges",
        frozenset({"current", "pressure_a", "pressure_b", "time"})),
    Law("actuation", "laminar edges", "-", "q (1 - sqrt(|dp| / (|dp| + transition)))",
        "1.0 - sqrt((abs(drop) + laminar) / (abs(drop) + laminar + transition))", 1.0,
        "Edges that pass less at small pressure drops: typical of flow that is laminar below and turbulent above; "
        "1: all of it.", where="edges", numbers=(Number("transition", "Pa", (1e5, 3e5, 1e6, 3e6)),)),
    Law("actuation", "flow force", "1/Pa", "q |dp|", "abs(drop)", 1e-9,
        "Edges that pass less the larger the pressure drop: typical of flow forces that close the spool, or of oil "
        "that cavitates.", where="edges"),
)  # fmt: skip


def _of_cell(channel: str, symbol: str, place: str) -> tuple[Law, ...]:
    bent = f"The load cell at the {place} reads a curve instead of a line: typical of a cell that is"
    return (
        Law("sensor", f"quadratic reading of {channel}", "1/N", f"{symbol}^2", "f * f", 3e-5,
            f"{bent} not alike in tension and compression.", where=channel),
        Law("sensor", f"odd quadratic reading of {channel}", "1/N", f"{symbol} |{symbol}|", "f * abs(f)", 3e-5,
            f"{bent} loaded beyond its range.", where=channel),
        Law("sensor", f"cubic reading of {channel}", "1/N2", f"{symbol}^3", "f * f * f", 1e-7,
            f"{bent} loaded beyond its range.", where=channel),
    )  # fmt: skip


_SENSORS: tuple[Law, ...] = (
    Law("sensor", "creep of the cell at the rod", "-", "w, w' = (f_h - w) / time", "w", 0.05,
        "The load cell at the piston rod goes on rising under a force that stays: typical of a glued strain gauge.",
        Element("lag", "force"), LAG, "hydraulic_force"),
    *_of_cell("hydraulic_force", "f_h", "piston rod"),
    *_of_cell("load_force", "f_l", "load"),
    *(Law("sensor", f"quadratic reading of pressure_{chamber}", "1/Pa", f"p_{chamber}^2",
          f"p_{chamber} * p_{chamber}", 1e-9, f"The pressure sensor of chamber {chamber.upper()} reads a curve instead "
          "of a line: typical of a membrane that is bent too far.", where=f"pressure_{chamber}")
      for chamber in "ab"),
)  # fmt: skip
LAWS = (*_FORCES, *_FLOWS, *_VALVE, *_SENSORS)
