# SPDX-License-Identifier: Apache-2.0
"""Assembly of the textbook equations and a bench's effects into symbolic functions of one sample.

::

    theta ── once ──> k         coefficients: expressions of parameters alone
    k, y ─── begin ──> y        hidden states of a bench at rest, from the six of the textbook
    y, u ─── enter ──> y        begin of a sample: past currents are shifted
    y, u ─── step ───> y        one integration step: spool, edges | Runge-Kutta 4 | discrete states | amplifiers
    y ────── read ───> z        the five readings, without noise
    y, u ─ motion ───> F, y'    forces and rates, for external solvers (`hydro_sim.export`)

    y = [ p_a  p_b  x_p  x_p'  F  F' | hidden states of the effects | past currents ]
          Pa   Pa   m    m/s   N  N/s                                 A, latest first

F is f_l behind the load cell's amplifier; of an ideal cell it is an output, on which no step depends. Edges are held
over a step at their mean. Pressures are limited to zero and above: the oil cavitates there, and the vapour's volume is
not modelled.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import pi
from types import SimpleNamespace
from typing import Any

import casadi
import numpy as np
from casadi import SX, vertcat

from hydro_sim.model import equations as eq
from hydro_sim.model import rates
from hydro_sim.model.effects.base import Effect, EffectContext
from hydro_sim.model.equations import READINGS, Symbol

casadi.GlobalOptions.setNumpyMode(-1)  # numpy's functions of symbols are symbols, without a warning

TEXTBOOK_STATES = ("pressure_a", "pressure_b", "piston_position", "piston_velocity", "load_force", "load_force_rate")
FORCE_NAMES = ("holding", "level_out", "level_back", "thrust", "level", "cell")
"""Forces [N]: friction that would hold the mass at rest; level of dry friction at rest, for either direction; force of
the piston on its load without dry friction; level of dry friction; force on an ideal load cell."""


@dataclass(frozen=True)
class Functions:
    """Functions of a model as CasADi symbols; see the module's docstring."""

    theta: SX
    k: SX
    y: SX
    current: SX
    share: SX
    """Fraction of the sample at which a step begins."""
    once: SX
    begin: SX
    enter: SX
    step: SX
    read: SX
    rates: SX
    """y' of the textbook's states and the integrated hidden ones."""
    past_currents: int
    """Number of past currents at the end of y."""
    rest: SX
    """The textbook's states of a bench at rest (`equations.rest_state`)."""
    slide: SX
    """Direction of motion, -1 or 1, against which dry friction acts; 0: it holds the mass."""
    dry_friction: bool
    """Whether dry friction can hold the mass."""
    ideal_cell: bool
    motion: SX
    """For external solvers: `FORCE_NAMES`, then y' for `slide`, unless states are discrete or currents late."""


class Assembly:
    """Assembly of a model from its bench's parameters and effects.

    `ranges`: range of each of the bench's parameters, by name. `effects`: in the order of the bench file.
    `ideal_cell`: whether the load cell is ideal. `past_currents`: number of past currents, for dead times.
    `substeps`: integration steps per sample of `period` [s].
    """

    def __init__(
        self, ranges: Mapping[str, tuple[float, float]], effects: Sequence[Effect], *, ideal_cell: bool,
        past_currents: int, substeps: int, period: float,
    ) -> None:  # fmt: skip
        self.effects, self.past_currents, self.period, self.step = effects, past_currents, period, period / substeps
        self._symbols: list[SX] = []
        self._expressions: list[SX] = []
        self.theta: dict[str, SX] = {name: SX.sym(name) for name in ranges}
        self.bench = SimpleNamespace(**self.theta)
        self.at = EffectContext(self.bench, self.step, self.hoist, partial(rates.dry_level, effects))
        for index, effect in enumerate(effects):
            effect.at = self.at
            for one in effect.parameters:
                name = f"{effect.id}.{one.name}.{index}"
                self.theta[name] = SX.sym(name)
                setattr(effect, one.name, self.theta[name])
        self.hidden = [(effect, one) for effect in effects for one in effect.states]
        self.integrated = [i for i, (_, one) in enumerate(self.hidden) if one.integrated]
        self.commanding = sorted(
            (one for one in effects if one.acts_in("command")), key=lambda effect: effect.acts_at_edges
        )
        bristles = any(effect.id == "friction_presliding" for effect in effects)
        self.holds = not bristles and any(effect.acts_in("dry_level") for effect in effects)
        """Whether dry friction can hold the mass: with bristles it deflects instead."""
        self.level: Callable[[Symbol], Symbol] = self.at.dry_level if self.holds else _nothing
        self.sliding: Callable[[Symbol], Symbol] = (
            (lambda velocity: np.sign(velocity) * self.level(velocity)) if self.holds else _nothing
        )
        n = self.bench
        for effect in effects:  # corrections of the bench file's parameters
            before = dict(vars(n))
            effect.correct(n)
            for name, (low, high) in ranges.items():
                if getattr(n, name) is not before[name] and getattr(n, name) is not None:
                    setattr(n, name, self.hoist(eq.clip(getattr(n, name), low, high)))
        ideal = ideal_cell or n.load_cell_bandwidth is None
        n.load_cell_omega = None if ideal else self.hoist(2.0 * pi * n.load_cell_bandwidth)
        drop, n.mobility = n.valve_nominal_pressure_drop, self.hoist(1.0 / n.moving_mass)
        n.valve_gain = self.hoist(n.valve_nominal_flow / (n.valve_nominal_current * np.sqrt(0.5 * drop)))
        self.y = SX.sym("y", len(TEXTBOOK_STATES) + len(self.hidden) + past_currents)
        self.current, self.share = SX.sym("u"), SX.sym("share")

    def functions(self) -> Functions:
        """Return all functions of the model."""
        y, at, first = self.y, self.at, self.y.numel() - self.past_currents
        # begin, enter
        self._bind([0.0] * len(self.hidden))
        signals, spool = self._truth(y), 0.0
        for effect in self.commanding:  # a lag begins at the spool's position after the null shifts before it
            effect.next = effect.begin(signals | {"spool": spool})
            spool = spool + effect.current if effect.id == "valve_offset" else spool
        values: list[Symbol] = []
        for effect in self.effects:
            started = effect.next if effect.acts_in("command") else effect.begin(signals)
            values += [started.get(one.name, 0.0) for one in effect.states]
        begin = vertcat(y[: len(TEXTBOOK_STATES)], *values, SX.zeros(self.past_currents))
        enter = vertcat(y[:first], self.current, y[first:-1]) if self.past_currents else y
        # read
        self._bind(casadi.vertsplit(y[len(TEXTBOOK_STATES) : first]) if self.hidden else [])
        signals, at.acceleration = self._truth(y), self._acceleration(y)
        at.pressures, at.position, at.velocity, at.load_force = (y[0], y[1]), y[2], y[3], y[4]
        for effect in self.effects:
            if effect.acts_in("filter_signal"):
                signals[effect.sensor] = effect.signal
        for effect in self.effects:
            signals = {channel: effect.read_sensor(channel, signal) for channel, signal in signals.items()}
        # motion, rates, step
        slide, motion = self._motion()
        start, edges = self._start()
        slopes: Any = vertcat(*self._rates(start, edges, self.sliding))
        step, rest = self._step(start, edges), SX(vertcat(*eq.rest_state(self.bench)))
        symbols, expressions = vertcat(*self._symbols), vertcat(*self._expressions)
        theta = vertcat(*self.theta.values())
        return Functions(
            theta=theta, k=vertcat(theta, symbols), y=y, current=self.current, share=self.share,
            once=vertcat(theta, expressions), begin=begin, enter=enter, step=step, read=SX(vertcat(*signals.values())),
            rates=slopes, past_currents=self.past_currents, rest=rest, slide=slide, dry_friction=self.holds,
            ideal_cell=self.bench.load_cell_omega is None, motion=motion,
        )  # fmt: skip

    def hoist(self, expression: Symbol) -> Symbol:
        """Return a symbol for an expression of parameters alone, computed once per parameter set."""
        if not isinstance(expression, SX):
            return expression
        if self._symbols:
            expression = casadi.substitute(expression, vertcat(*self._symbols), vertcat(*self._expressions))
        for symbol, known in zip(self._symbols, self._expressions, strict=True):
            if casadi.is_equal(known, expression, 20):
                return symbol
        self._symbols.append(SX.sym(f"k{len(self._symbols)}"))
        self._expressions.append(expression)
        return self._symbols[-1]

    # --- the parts of a sample ---------------------------------------------------------------------------------------

    def _bind(self, hidden: Sequence[Symbol]) -> None:
        for (effect, one), value in zip(self.hidden, hidden, strict=True):
            setattr(effect, one.name, value)

    def _delayed(self) -> Symbol:
        """Mean current [A] over the step, the dead times earlier: each past sample by its share of the step."""
        if not self.past_currents:
            return self.current
        together = sum(effect.time for effect in self.effects if effect.id == "transport_delay")
        begin = self.share - self.hoist(together / self.period)
        width, first, mean = self.step / self.period, self.y.numel() - self.past_currents, 0.0
        for age in range(self.past_currents):
            covered = np.fmin(begin + width, 1.0 - age) - np.fmax(begin, -age)
            mean = mean + self.y[first + age] * np.fmax(covered, 0.0)
        return mean / width

    def _edges(self, spool: Symbol) -> rates.EdgeConductances:
        """Conductances [m3/s/sqrt(Pa)] of the four edges (`equations.EDGES`) at the spool's position [A]."""
        gain, all_wide = self.bench.valve_gain, 0.0

        def openings(width: Symbol) -> tuple[Symbol, Symbol]:
            out, back = gain * np.fmax(width + spool, 0.0), gain * np.fmax(width - spool, 0.0)
            for effect in self.effects:
                out, back = effect.openings(out, back, spool)
            return out, back

        for effect in self.effects:
            all_wide = effect.underlap(all_wide)
        out, back = openings(all_wide)
        edges = [out, back, back, out]
        for effect in self.effects:
            if effect.edge:
                (width, share), k = effect.land(all_wide), eq.EDGES.index(effect.edge)
                edges[k] = share * openings(width)[eq.OPENS_BACK[k]]
        return edges[0], edges[1], edges[2], edges[3]

    def _truth(self, y: Any) -> dict[str, Symbol]:
        values = eq.hydraulic_force(self.bench, y[0], y[1]), y[4], y[0], y[1], y[2]
        return dict(zip(READINGS, values, strict=True))

    def _acceleration(self, y: SX) -> Symbol:
        """x'' [m/s2] in a state, if an effect shows it: that of the forces, which the valve does not change at once."""
        if not any(effect.depends_on_acceleration for effect in self.effects):
            return 0.0
        return rates.textbook_rates(self.at, self.effects, casadi.vertsplit(y)[:6], (0.0,) * 4, self.sliding)[0][3]

    def _cell_force(self, y: Sequence[Symbol]) -> Symbol:
        """f_l [N] on an ideal load cell: the load's force in this state, and no state of its own."""
        self.at.velocity = y[3]
        force = rates.load_force(self.bench, self.effects, y[2])
        if any(effect.acts_in("inertia") for effect in self.effects):
            force = force + rates.added_mass(self.effects, y[2]) * self._acceleration(SX(vertcat(*y[:6])))
        return force

    def _motion(self) -> tuple[SX, SX]:
        """Direction of motion, and the forces and rates for it."""
        start, _ = self._start()
        flowing: dict[tuple[int, str], Symbol] = {}

        def flow(effect: Effect, signal: Symbol) -> Symbol:
            passed, slopes = effect.continuous_rates(signal)
            flowing.update({(id(effect), name): slope for name, slope in slopes.items()})
            return passed

        spool = self._delayed()
        for effect in self.commanding:
            spool = flow(effect, spool) if effect.acts_in("continuous_rates") else effect.command(spool)
        self.at.spool = spool
        edges, slide = self._edges(spool), SX.sym("slide")
        free = self._rates(start, edges, _nothing)
        mass = self.bench.moving_mass + rates.added_mass(self.effects, start[2])
        holding, load = mass * free[3], rates.load_force(self.bench, self.effects, start[2])
        level, speed = self.level, np.fmax(np.abs(start[3]), rates.STANDSTILL_VELOCITY)
        against = eq.choose(slide == 0.0, holding, slide * level(slide * speed))
        slopes = self._rates(start, edges, lambda velocity: against) if self.holds else free
        signals = self._truth(start)
        for effect in self.effects:
            if effect.acts_in("continuous_rates") and effect.acts_in("filter_signal"):
                signals[effect.sensor] = flow(effect, signals[effect.sensor])
        integrated = dict(zip(self.integrated, slopes[len(TEXTBOOK_STATES) :], strict=True))
        hidden = [integrated.get(i, flowing.get((id(effect), one.name))) for i, (effect, one) in enumerate(self.hidden)]
        steps = self.past_currents or any(slope is None for slope in hidden)
        turned = level(rates.STANDSTILL_VELOCITY), level(-rates.STANDSTILL_VELOCITY)
        now = level(eq.choose(start[3] >= 0.0, speed, -speed))
        forces = (holding, *turned, holding + load, now, self._cell_force(start))
        return slide, vertcat(*forces, *([] if steps else [*slopes[: len(TEXTBOOK_STATES)], *hidden]))

    # --- an integration step -----------------------------------------------------------------------------------------

    def _rates(
        self, y: Sequence[Symbol], edges: rates.EdgeConductances, dry: Callable[[Symbol], Symbol]
    ) -> list[Symbol]:
        """y' of the textbook's states and of the integrated hidden ones; `dry`: force [N] at a velocity."""
        hidden = self.hidden_now.copy()
        for place, i in enumerate(self.integrated):
            hidden[i] = y[len(TEXTBOOK_STATES) + place]
        self._bind(hidden)
        slopes, drawn = rates.textbook_rates(self.at, self.effects, y, edges, dry)
        return slopes + [self.hidden[i][0].rates(drawn)[self.hidden[i][1].name] for i in self.integrated]

    def _start(self) -> tuple[list[Symbol], rates.EdgeConductances]:
        """Start of a step: integrated states, and the edges at the spool's mean position over it."""
        self.hidden_now = [self.y[len(TEXTBOOK_STATES) + i] for i in range(len(self.hidden))]
        self._bind(self.hidden_now)
        self.at.initial_position = self.y[2]
        for effect in self.effects:
            effect.next = {}
        states = [self.y[i] for i in range(len(TEXTBOOK_STATES))] + [self.hidden_now[i] for i in self.integrated]
        if self.bench.load_cell_omega is None:
            states[4] = self._cell_force(states)
        spool = self._delayed()
        for effect in self.commanding:
            spool = effect.command(spool)
        self.at.spool, self.at.current = spool, self.current
        return states, self._edges(spool)

    def _step(self, start: list[Symbol], edges: rates.EdgeConductances) -> SX:
        """y after a step of Runge-Kutta 4."""
        first = self._rates(start, edges, _nothing)
        dry: Callable[[Symbol], Symbol] = _nothing
        if self.holds:
            dragged = rates.added_mass(self.effects, start[2])
            mass = self.bench.moving_mass + dragged
            dry, at_end = rates.stick_slip_friction(self.level, mass, start[3], first[3], self.step)
            mobility = self.bench.mobility if isinstance(dragged, float) else 1.0 / mass
            first[3] = first[3] - dry(start[3]) * mobility
        slopes, weights = [first], (1.0, 2.0, 2.0, 1.0)
        for reach in (0.5 * self.step, 0.5 * self.step, self.step):
            probe = [value + reach * slope for value, slope in zip(start, slopes[-1], strict=True)]
            slopes.append(self._rates(probe, edges, dry))
        mean = [sum(w * s for w, s in zip(weights, each, strict=True)) / 6.0 for each in zip(*slopes, strict=True)]
        end = [value + self.step * slope for value, slope in zip(start, mean, strict=True)]
        end[0], end[1] = np.fmax(end[0], 0.0), np.fmax(end[1], 0.0)
        end[3] = at_end(end[3]) if self.holds else end[3]
        self._bind(self.hidden_now)
        for effect in self.effects:
            effect.advance_states(end[2], end[3])
        late = list(end)
        if self.bench.load_cell_omega is None:
            hidden = list(self.hidden_now)
            self._bind([effect.next.get(one.name, old) for (effect, one), old in zip(self.hidden, hidden, strict=True)])
            late[4] = self._cell_force(end)
            self._bind(hidden)
        before, after = self._truth(start), self._truth(late)
        signals = {channel: (before[channel], after[channel]) for channel in READINGS}
        for effect in self.effects:
            signals = {channel: effect.filter_signal(channel, *pair) for channel, pair in signals.items()}
        remembered = [
            effect.next.get(one.name, old) for (effect, one), old in zip(self.hidden, self.hidden_now, strict=True)
        ]
        for i, value in zip(self.integrated, end[6:], strict=True):
            remembered[i] = value
        past = self.y[self.y.numel() - self.past_currents :] if self.past_currents else SX(0, 1)
        return vertcat(*late[:6], *remembered, past)


def _nothing(velocity: Symbol) -> Symbol:
    return 0.0
