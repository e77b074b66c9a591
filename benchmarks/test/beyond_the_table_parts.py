# SPDX-License-Identifier: Apache-2.0
"""Parts of the laws of unnamed physics, by signals of a run: a second derivation, without the plant's code."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from benchmarks.test.beyond_the_table_log import AREA_B, BENCH, GAIN, PERIOD, REST, START, FloatArray, Signals


def lag(signal: FloatArray, seconds: float) -> FloatArray:
    """First-order lag from rest, exact for a signal that is held from row to row."""
    out, share = np.zeros_like(signal), 1.0 - math.exp(-PERIOD / seconds)
    for k in range(1, len(signal)):
        out[k] = out[k - 1] + share * (signal[k - 1] - out[k - 1])
    return out


def followed(signal: FloatArray, start: float, rate: Callable[[float, float], float], substeps: int = 20) -> FloatArray:
    """What follows a signal at a rate of signal and state, the signal taken as straight from row to row."""
    out = np.full_like(signal, start)
    for k in range(1, len(signal)):
        out[k] = out[k - 1]
        for j in range(substeps):
            between = signal[k - 1] + (j + 0.5) / substeps * (signal[k] - signal[k - 1])
            out[k] += PERIOD / substeps * rate(between, out[k])
    return out


def stubbed(pressure: FloatArray, size: float, compliance: float) -> FloatArray:
    """Flow [m3/s] into a damper behind an orifice."""

    def filled(p: float, w: float) -> float:
        return math.copysign(size * math.sqrt(abs(p - w)), p - w) / compliance

    inside = followed(pressure, pressure[0], filled)
    return np.asarray(size * np.sign(pressure - inside) * np.sqrt(np.abs(pressure - inside)))


def slipped(position: FloatArray, rate: float, threshold: float) -> FloatArray:
    """How far [m] a specimen has slipped in its jaws."""

    def slip(x: float, y: float) -> float:
        force = BENCH.spring_stiffness * (x - REST - y)
        return rate * math.copysign(max(abs(force) - threshold, 0.0), force)

    return followed(position, 0.0, slip)


def slewed(force: FloatArray, fastest: float, seconds: float) -> FloatArray:
    """What an input shows that follows at a limited rate."""
    return followed(force, 0.0, lambda f, w: min(max((f - w) / seconds, -fastest), fastest))


def one_sided(current: FloatArray, rising: float, falling: float) -> FloatArray:
    """Mean from row to row of a spool that follows late, by another time on the way up; exact for a held current."""
    out, spool = np.zeros_like(current), 0.0
    for k, held in enumerate(current):
        share = PERIOD / (rising if held > spool else falling)
        out[k] = held + (spool - held) * -math.expm1(-share) / share
        spool = held + (spool - held) * math.exp(-share)
    return out


def set_down(s: Signals, sag: float, seconds: float) -> FloatArray:
    """Flow into A [m3/s] that a supply does not give whose pressure sags from row to row, halfway between rows."""
    lost = sag * -np.expm1(-PERIOD * (np.arange(len(s.a)) + 0.5) / seconds)
    above = BENCH.supply_pressure - s.a
    return np.asarray(GAIN * np.maximum(s.u, 0.0) * (np.sqrt(above) - np.sqrt(above - lost)))


def dammed(s: Signals, resistance: float, seconds: float) -> FloatArray:
    """Flow out of B [m3/s] that a return line's pressure keeps back, which follows the flow to the tank late."""
    opened, above, back, out = GAIN * np.abs(s.u), np.where(s.u >= 0.0, s.b, s.a), 0.0, np.zeros_like(s.a)
    steps = 20
    for k in range(len(out)):
        for _ in range(steps):
            out[k] += opened[k] * (math.sqrt(above[k]) - math.sqrt(above[k] - back)) / steps
            flow = opened[k] * math.sqrt(above[k] - back)
            back += PERIOD / steps * (resistance * flow - back) / seconds
    return np.asarray(np.where(s.u >= 0.0, out, 0.0))


def covered(s: Signals, share: float, end: float) -> FloatArray:
    """Flow into A [m3/s] that the piston keeps back where it covers the port."""
    return np.asarray(over_a(s) * s.u * share * np.clip(end - s.x, 0.0, None))


def signed_root(difference: FloatArray) -> FloatArray:
    return np.asarray(np.sign(difference) * np.sqrt(np.abs(difference)))


def warmth(s: Signals, seconds: float) -> FloatArray:
    return lag(np.abs(s.u) / BENCH.valve_nominal_current, seconds)


def bump(position: FloatArray, place: float, width: float) -> FloatArray:
    return np.asarray(np.exp(-(((position - place) / width) ** 2)))


def over_a(s: Signals) -> FloatArray:
    """Flow into A by current [m3/s/A]."""
    return np.asarray(GAIN * np.sqrt(np.where(s.u >= 0.0, BENCH.supply_pressure - s.a, s.a)))


def kept_back(s: Signals, resistance: float) -> FloatArray:
    """Flow out of B that a filter behind the valve keeps back, by bisection of q = g u sqrt(p_b - R q^2)."""
    opened = GAIN * np.maximum(s.u, 0.0)
    wide = opened * np.sqrt(s.b)
    low, high = np.zeros_like(wide), wide
    for _ in range(50):
        flow = 0.5 * (low + high)
        short = flow < opened * np.sqrt(np.maximum(s.b - resistance * flow**2, 0.0))
        low, high = np.where(short, flow, low), np.where(short, high, flow)
    return np.asarray(np.where(s.u > 0.0, wide - low, 0.0))


def throttled(pressure: FloatArray, falling: float) -> FloatArray:
    """Pressure behind a check valve with a throttle beside it, that opens at once."""
    out = pressure.copy()
    for k in range(1, len(out)):
        out[k] = max(out[k], out[k] + (out[k - 1] - out[k]) * math.exp(-PERIOD / falling))
    return out


def path(travelled: FloatArray, width: float) -> FloatArray:
    """Where in its play something stands that is dragged along, -1 to 1: relaxes over a path, not over a time."""
    out = np.zeros_like(travelled)
    for k in range(1, len(out)):
        moved = travelled[k] - travelled[k - 1]
        out[k] = np.sign(moved) + (out[k - 1] - np.sign(moved)) * math.exp(-abs(moved) / width)
    return out


def behind_play(read: FloatArray, size: float, width: float) -> FloatArray:
    """Position [m] whose encoder reads this behind a coupling with play, by iteration."""
    position = read
    for _ in range(30):
        position = read + size * path(position, width)
    return position


def sagged(s: Signals, size: float) -> FloatArray:
    """What a hydraulic cell misses [N] whose supply the valve's current loads: `s.b` holds what it reads."""
    read, share = BENCH.piston_area * s.a - AREA_B * s.b, size * np.abs(s.u) / BENCH.valve_nominal_current
    return np.asarray(read * share / (1.0 - share))


def squeezed(velocity: FloatArray, seconds: float, travel: float) -> FloatArray:
    """Share of the lips without a film, exact for a velocity that is held from row to row."""
    out = np.ones_like(velocity)
    for k in range(1, len(out)):
        rate = 1.0 / seconds + abs(velocity[k - 1]) / travel
        rest = 1.0 / seconds / rate
        out[k] = rest + (out[k - 1] - rest) * math.exp(-PERIOD * rate)
    return out


def choked(s: Signals, share: float, threshold: float) -> FloatArray:
    """Flow out of B that jets into the tank do not pass."""
    acting = s.b - share * np.maximum(s.b - threshold, 0.0)
    return np.asarray(GAIN * np.maximum(s.u, 0.0) * (np.sqrt(s.b) - np.sqrt(acting)))


def drops(s: Signals) -> FloatArray:
    """Pressure [Pa] over both edges that are open."""
    return np.asarray(np.where(s.u >= 0.0, BENCH.supply_pressure - s.a + s.b, s.a + BENCH.supply_pressure - s.b))


def passed(s: Signals, spool: FloatArray) -> FloatArray:
    """Flow into A [m3/s] over a spool [A], beyond that over the current."""
    return np.asarray(over_a(s._replace(u=spool)) * spool - over_a(s) * s.u)


def strained(pressure: FloatArray, seconds: float) -> FloatArray:
    """By how much [Pa] a pressure is above what a lip has flowed to."""
    return np.asarray(pressure - followed(pressure, pressure[0], lambda p, w: (p - w) / seconds))


def pocketed(pressure: FloatArray, filling: float, emptying: float) -> FloatArray:
    """Rate [Pa/s] of the pressure in a pocket that fills fast and empties slowly."""

    def rate(p: float, w: float) -> float:
        return (p - w) / (filling if p > w else emptying)

    inside = followed(pressure, pressure[0], rate)
    return np.array([rate(p, w) for p, w in zip(pressure, inside, strict=True)])


def late(current: FloatArray, seconds: float) -> FloatArray:
    """Mean from row to row of what follows a held current late."""
    return one_sided(current, seconds, seconds)


def drawn_down(s: Signals, sag: float, period: float) -> FloatArray:
    """Flow into A [m3/s] that a supply does not give whose pressure another consumer lowers now and then."""
    busy = np.arange(len(s.a)) * PERIOD % period >= 0.5 * period - 1e-9
    above = BENCH.supply_pressure - s.a
    return np.asarray(GAIN * np.maximum(s.u, 0.0) * (np.sqrt(above) - np.sqrt(above - sag * busy)))


def run_along(velocity: FloatArray, taken: float, stopped: float) -> FloatArray:
    """Velocity [m/s] of a flywheel that only a faster rod drives."""
    return followed(velocity, 0.0, lambda v, w: max(v - w, 0.0) / taken - w / stopped)


def unrippled(read: FloatArray, size: float, pitch: float) -> FloatArray:
    """Position [m] whose scale reads this, by iteration."""
    position = read
    for _ in range(30):
        position = read - size * np.sin(2.0 * np.pi * position / pitch)
    return position


def held(signal: FloatArray, rows: int) -> FloatArray:
    """What a converter shows that converts every so many rows."""
    return np.asarray(signal[np.arange(len(signal)) // rows * rows])


def parted(s: Signals, size: float) -> FloatArray:
    """Flow out of B [m3/s] beyond the current's, where B's edges stand by this [A] nearer to the supply's side."""
    spool = s.u - size
    there = spool * np.sqrt(np.where(spool >= 0.0, s.b, BENCH.supply_pressure - s.b))
    return np.asarray(GAIN * (there - s.u * np.sqrt(np.where(s.u >= 0.0, s.b, BENCH.supply_pressure - s.b))))


def magnetised(current: FloatArray, threshold: float, seconds: float) -> FloatArray:
    """Mean from row to row of what follows a held current late, and only where it is strong."""
    out, flux, share = np.zeros_like(current), 0.0, PERIOD / seconds
    for k, held_current in enumerate(current):
        followed_by = share if abs(held_current) > threshold else 0.0
        after = held_current + (flux - held_current) * math.exp(-followed_by)
        out[k], flux = 0.5 * (flux + after), after
    return out


def at_rows(between: FloatArray, first: float) -> FloatArray:
    """Values at rows whose means from row to row are these."""
    out = np.full(len(between) + 1, first)
    for k, mean in enumerate(between):
        out[k + 1] = 2.0 * mean - out[k]
    return out


def stored(pressure: FloatArray, precharge: float) -> FloatArray:
    """Rate [Pa/s] of a pressure beyond a precharge, of means from row to row of a run that has begun in balance."""
    above = np.clip(at_rows(pressure, START / BENCH.area_ratio) - precharge, 0.0, None)
    return np.asarray(np.diff(above) / PERIOD)


def farthest(stretch: FloatArray, seconds: float, healing: float) -> FloatArray:
    """Stretch [m] that rubber has had, as far as it has not healed."""
    return followed(np.abs(stretch), 0.0, lambda z, w: max(z - w, 0.0) / seconds - w / healing)


def remembered(position: FloatArray, softening: float, healing: float) -> FloatArray:
    """Load [N] that rubber misses."""
    stretch = position - REST
    return np.asarray(softening * (farthest(stretch, 5e-3, healing) - np.abs(stretch)) * stretch)


def missed(read: FloatArray, share: float, threshold: float) -> FloatArray:
    """What an encoder misses [m] that reads this velocity."""
    fast = np.sign(read) * np.clip(np.abs(read) - threshold, 0.0, None)
    return np.asarray(PERIOD * np.cumsum(fast) * share / (1.0 - share))


def dragged(current: FloatArray, half: float, seconds: float) -> FloatArray:
    """Mean from row to row of what a held current drags along that has this play [A] either way, within a time."""
    out, now = np.zeros_like(current), 0.0
    for k, drawn in enumerate(current):
        there = min(max(now, drawn - half), drawn + half)
        out[k] = there + (now - there) * seconds / PERIOD
        now = there
    return out


def hunted(s: Signals, size: float, frequency: float) -> FloatArray:
    """Flow into A [m3/s] that a supply gives whose pressure swings about its own, halfway between rows."""
    swung = size * np.sin(2.0 * np.pi * frequency * PERIOD * (np.arange(len(s.a)) + 0.5))
    above = BENCH.supply_pressure - s.a
    return np.asarray(GAIN * np.maximum(s.u, 0.0) * (np.sqrt(above + swung) - np.sqrt(above)))


def followed_with_play(current: FloatArray, width: float) -> FloatArray:
    """What follows a current behind play, from the middle of it."""
    out, before = np.zeros_like(current), 0.0
    for k, held_current in enumerate(current):
        away = before - held_current
        before = held_current + math.copysign(min(abs(away), 0.5 * width), away)
        out[k] = before
    return out
