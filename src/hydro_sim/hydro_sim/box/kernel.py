# SPDX-License-Identifier: Apache-2.0
"""The compiled kernel of `box.box`, on records of settings, command and state.

The same compiled functions serve the call per millisecond and the offline loop: both give bit-identical results.
"""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np

from hydro_bridge.serial.protocol import BoxLaw
from hydro_bridge.signals import SAMPLE_PERIOD, Flag, Law, Waveform
from hydro_sim.box import force_law, reference
from hydro_sim.jit import njit

ARMED, SATURATED, WATCHDOG = int(Flag.ARMED), int(Flag.SATURATED), int(Flag.WATCHDOG)
TRIPPED, SENSOR_FAULT = int(Flag.TRIPPED), int(Flag.SENSOR_FAULT)
FORCE_LIMIT, FILTER_STALE = int(Flag.FORCE_LIMIT), int(Flag.FILTER_STALE)
PAPER, COMPENSATED = int(Law.PAPER), int(Law.COMPENSATED)
LAST_WAVEFORM = int(max(Waveform))

LAW_DTYPE = np.dtype(
    [(entry.name, np.float64, (4,) if entry.name.startswith("coefficient") else ()) for entry in fields(BoxLaw)]
)
"""`BoxLaw` for compiled code."""

_LIMITS = ("delta_u_max", "load_force_limit", "hold_timeout", "trip_timeout", "gain_floor", "recovery_margin")
SETTINGS_DTYPE = np.dtype(
    [(name, np.float64) for name in _LIMITS]
    + [("feedback_channel", np.int64), ("integral_form", np.int64)]
    + [("low", np.float64, (8,)), ("high", np.float64, (8,)), ("paper", LAW_DTYPE), ("compensated", LAW_DTYPE)]
)
"""`BoxConfig` for compiled code; `integral_form` is its number in `serial.protocol.INTEGRAL_FORMS`, `low` and
`high` bound each entry of the measurement."""

_COMMANDED = [("delta_kp", np.float64), ("delta_ki", np.float64), ("delta_u", np.float64)]
SHAPING_DTYPE = np.dtype(
    [("coefficients", np.float64, (4,)), ("velocity_compensation", np.float64), ("valve_gain_scale", np.float64)]
)
"""What shapes the compensated law: a_0 to a_3, C_1, C_2."""
COMMAND_DTYPE = np.dtype(
    [("arm", np.bool_), ("filter_fresh", np.bool_), *_COMMANDED, ("reference", reference.SIGNAL_DTYPE)]
    + [("law", np.int64), ("shaping", SHAPING_DTYPE)],
    align=True,
)
STATE_DTYPE = np.dtype(
    [("sequence", np.uint32), ("faults", np.uint32), ("refused", np.int64), ("refused_references", np.int64)]
    + [(name, np.bool_) for name in ("arm_wanted", "disarm_seen", "armed", "tripped", "filter_fresh")]
    + [*_COMMANDED, ("received_at", np.float64), ("integral", np.float64), ("reference", reference.REFERENCE_DTYPE)]
    + [("armed_at", np.float64), ("excess", np.float64), ("law", np.int64), ("law_wanted", np.int64)]
    + [("wanted", SHAPING_DTYPE), ("acting", SHAPING_DTYPE)]
    + [(name, np.float64) for name in ("compensated_reference", "compensated_reference_rate", "second")],
    align=True,
)
"""State of the box; `integral` is what the integrator carries (`force_law`), `faults` are the flags of the
faults that tripped it, `excess` [N] is by how much the load force stood beyond its limit when the box was armed.
`law` is the one that acts, `acting` its shaping of the last sample, with f_c [N] and f_c' [N/s] beside it; `second`
[N/s^2] is what f_c takes f_r'' for, on the way to the next sample."""

CORRECTION_HOLD = 3.5e-3
"""Time [s] for which a command's correction acts: decided for one sample, an impulse if held (decision 64)."""

KINK = 4e-3
"""Time constant [s] with which a jump of f_r'' (at the ends of fades and of a smooth step's edges) comes into f_c."""

RECOVERY = 1.0
"""Time [s] after arming within which a load force that began beyond its limit must return."""


@njit
def reset(states):
    """Reset to power-on; `states` of shape (1,)."""
    state = states[0]
    state.sequence, state.faults = np.uint32(0), np.uint32(0)
    state.refused = state.refused_references = 0
    state.arm_wanted = state.disarm_seen = state.armed = state.tripped = state.filter_fresh = False
    state.delta_kp = state.delta_ki = state.delta_u = state.integral = 0.0
    state.received_at = state.armed_at = -math.inf
    state.excess = 0.0
    state.reference.wanted.waveform, state.reference.wanted.amplitude, state.reference.wanted.offset = 0, 0.0, 0.0
    state.reference.wanted.frequency, state.reference.wanted.phase = 1.0, 0.0
    reference.begin(state.reference, 0.0, 0.0)
    state.law = state.law_wanted = PAPER
    state.compensated_reference = state.compensated_reference_rate = 0.0
    for shaping in (state.wanted, state.acting):
        shaping.velocity_compensation = shaping.valve_gain_scale = shaping.coefficients[0] = 1.0
        shaping.coefficients[1:] = 0.0


@njit
def law_of(limits, law):
    """Record of `LAW_DTYPE` of a law by its number."""
    return limits.compensated if law == COMPENSATED else limits.paper


@njit
def receive(settings, states, commands, time):
    """Take in a command at box time [s]; all arrays of shape (1,)."""
    state, limits, command = states[0], settings[0], commands[0]
    state.received_at = time
    state.arm_wanted = command.arm
    if not command.arm:
        state.disarm_seen = True
    state.filter_fresh = command.filter_fresh
    if command.law == PAPER or command.law == COMPENSATED:
        state.law_wanted = command.law
    else:
        state.refused += 1
    law = law_of(limits, state.law_wanted)
    state.delta_kp = _admitted(state, command.delta_kp, 0.0, law.delta_kp_min, law.delta_kp_max)
    state.delta_ki = _admitted(state, command.delta_ki, 0.0, law.delta_ki_min, law.delta_ki_max)
    _admit_shaping(state, law, command.shaping)
    state.delta_u = _admitted(state, command.delta_u, 0.0, -limits.delta_u_max, limits.delta_u_max)
    if _playable(command.reference, limits.high[limits.feedback_channel]):
        reference.copy_signal(command.reference, state.reference.wanted)
        if command.reference.waveform == reference.HOLD:
            state.reference.wanted.frequency = 1.0  # it has none, whatever was sent: none reaches the derivative
    else:
        state.refused += 1
        state.refused_references += 1


@njit
def _admitted(state, value, safe, low, high):
    """The value clamped, or the safe one if it is not finite; either is counted."""
    if low <= value <= high:
        return value
    state.refused += 1
    return min(max(value, low), high) if math.isfinite(value) else safe


@njit
def _admit_shaping(state, law, shaping):
    """Take in a command's coefficients and scales, each within the law's limits."""
    for i in range(4):
        low, high = law.coefficient_min[i], law.coefficient_max[i]
        neutral = 1.0 if i == 0 else 0.0
        state.wanted.coefficients[i] = _admitted(state, shaping.coefficients[i], neutral, low, high)
    safe, low, high = law.velocity_compensation, law.velocity_compensation_min, law.velocity_compensation_max
    state.wanted.velocity_compensation = _admitted(state, shaping.velocity_compensation, safe, low, high)
    safe, low, high = law.valve_gain_scale, law.valve_gain_scale_min, law.valve_gain_scale_max
    state.wanted.valve_gain_scale = _admitted(state, shaping.valve_gain_scale, safe, low, high)


@njit
def _playable(signal, force_range):
    """Return whether the reference stays within what the load cell can show [N]; false of anything that is not finite.

    A HOLD has no frequency: its own may be any finite number.
    """
    levels = signal.amplitude >= 0.0 and signal.amplitude + abs(signal.offset) <= force_range
    shape = 0 <= signal.waveform <= LAST_WAVEFORM and math.isfinite(signal.phase)
    if signal.waveform == reference.HOLD:
        return levels and shape and math.isfinite(signal.frequency)
    return levels and shape and 0.0 < signal.frequency < 1.0 / SAMPLE_PERIOD


@njit
def tick(bench, settings, states, measurement, time, outputs):
    """One sample: `measurement` x, shape (8,), at box time [s]; fills `outputs`, shape (1,), of BenchState."""
    state, limits, output = states[0], settings[0], outputs[0]
    late = _watch(state, limits, time)
    _follow_disarm(state)
    _check(state, limits, measurement, time)
    _follow_arm(state, limits, measurement, time)
    held = late or state.law != state.law_wanted
    output.time, output.sequence = time, state.sequence
    _show_measurement(measurement, output)
    _show_gains(state, limits, held, output)
    saturated = _control(bench[0], limits, state, measurement, held, time, output)
    output.flags = _flags(state, late, saturated)
    state.sequence = np.uint32(state.sequence + 1)


@njit
def _watch(state, limits, time):
    """Return whether commands are late; if they are gone for good, the box trips and wants to see a disarm."""
    age = time - state.received_at
    if age > limits.trip_timeout:
        state.tripped = state.tripped or state.armed
        state.arm_wanted = state.disarm_seen = False
    return age > limits.hold_timeout


@njit
def _follow_disarm(state):
    """A disarm that was seen ends a trip and forgets its causes; if one is still there, `_check` finds it again."""
    if not state.arm_wanted:
        state.armed = False
        state.law = state.law_wanted
        if state.disarm_seen:
            state.tripped = False
            state.faults = np.uint32(0)


@njit
def _check(state, limits, measurement, time):
    """Trip on what cannot be or must not be; the causes stay until the disarm."""
    for i in range(8):
        if not limits.low[i] <= measurement[i] <= limits.high[i]:  # also true of NaN
            state.faults |= np.uint32(SENSOR_FAULT)
    if state.armed and abs(measurement[2]) > limits.load_force_limit + _allowance(state, time):
        state.faults |= np.uint32(FORCE_LIMIT)
    if state.faults != 0:
        state.tripped = True


@njit
def _allowance(state, time):
    """Allowed excess [N] of the force beyond its limit: as at arming, falling to zero within `RECOVERY`.

    A closed valve holds the force that tripped the box, and only the armed loop can take it back.
    """
    return state.excess * max(0.0, 1.0 - (time - state.armed_at) / RECOVERY)


@njit
def _follow_arm(state, limits, measurement, time):
    """Arm if the diagram in `hydro_sim.box.box` allows it: the reference then fades in from the measured force."""
    if state.tripped:
        state.armed = False
    elif state.arm_wanted and not state.armed:
        state.armed, state.tripped = state.disarm_seen, not state.disarm_seen
        state.disarm_seen = False
        state.integral, state.second, state.law = 0.0, 0.0, state.law_wanted
        _begin_shaping(state.acting, law_of(limits, state.law))
        beyond = abs(measurement[2]) - limits.load_force_limit
        state.armed_at, state.excess = time, beyond + limits.recovery_margin if beyond > 0.0 else 0.0
        reference.begin(state.reference, measurement[limits.feedback_channel], time)


@njit
def _begin_shaping(shaping, law):
    """Begin with the law's safe state."""
    shaping.coefficients[0], shaping.coefficients[1:] = 1.0, 0.0
    shaping.velocity_compensation, shaping.valve_gain_scale = law.velocity_compensation, law.valve_gain_scale


@njit
def _compensate(state, law, held, wave):
    """f_c [N] and f_c' [N/s] of the reference and its derivatives; coefficients and scales come nearer by one sample.

    Where f_c is cut off at its limit, f_c' is zero.
    """
    acting, wanted = state.acting, state.wanted
    second, third = _without_jumps(state, wave[2], wave[3])
    terms, slopes = (wave[0], wave[1], second, 1.0), (wave[1], wave[2], third, 0.0)
    scales = law.scale_rate * SAMPLE_PERIOD
    c_1 = law.velocity_compensation if held else wanted.velocity_compensation
    c_2 = law.valve_gain_scale if held else wanted.valve_gain_scale
    acting.velocity_compensation += min(max(c_1 - acting.velocity_compensation, -scales), scales)
    acting.valve_gain_scale += min(max(c_2 - acting.valve_gain_scale, -scales), scales)
    value, rate = 0.0, 0.0
    for i in range(4):
        neutral = 1.0 if i == 0 else 0.0
        target, step = neutral if held else wanted.coefficients[i], law.coefficient_rate[i] * SAMPLE_PERIOD
        change = min(max(target - acting.coefficients[i], -step), step)
        acting.coefficients[i] += change
        value += acting.coefficients[i] * terms[i]
        rate += acting.coefficients[i] * slopes[i] + change / SAMPLE_PERIOD * terms[i]
    if abs(value) > law.reference_max:
        return math.copysign(law.reference_max, value), 0.0
    return value, rate


@njit
def _without_jumps(state, second, third):
    """f_r'' [N/s^2] and f_r''' [N/s^3] as f_c has them: exact, but a jump of f_r'' comes in with `KINK`."""
    half = 0.5 * SAMPLE_PERIOD
    followed = state.second + half * third
    followed += SAMPLE_PERIOD / (KINK + SAMPLE_PERIOD) * (second - followed)
    state.second = followed + half * third
    return followed, third + (second - followed) / KINK


@njit
def _control(bench, limits, state, measurement, held, time, output):
    """Reference, force law and saturation into `output`; whether the current stands at its limit."""
    force = measurement[limits.feedback_channel]
    output.valve_current = output.nominal_valve_current = 0.0
    output.reference_force, output.reference_force_rate = force, 0.0
    state.compensated_reference, state.compensated_reference_rate = force, 0.0
    if not state.armed:
        _begin_shaping(state.acting, law_of(limits, state.law))
        return False
    wave = reference.advance(state.reference, time)
    wanted, wanted_rate = _compensate(state, law_of(limits, state.law), held, wave)
    error = wanted - force
    k_p, k_i = output.proportional_gain, output.integral_gain
    action = force_law.integral_action(limits.integral_form, state.integral, k_i)
    nominal = force_law.nominal_current(
        bench, measurement, error, action, wanted_rate, k_p, limits.gain_floor, state.acting.velocity_compensation,
        state.acting.valve_gain_scale,
    )  # fmt: skip
    if not math.isfinite(nominal):  # nothing that was admitted leads here; the valve must not depend on that
        state.armed, state.tripped = False, True
        return False
    unlimited = nominal if held or time - state.received_at > CORRECTION_HOLD else nominal + state.delta_u
    current = min(max(unlimited, -bench.valve_current_max), bench.valve_current_max)
    form, step = limits.integral_form, SAMPLE_PERIOD
    state.integral = force_law.integrate(form, state.integral, error, k_i, unlimited, current, step)
    output.valve_current, output.nominal_valve_current = current, nominal
    output.reference_force, output.reference_force_rate = wave[0], wave[1]
    state.compensated_reference, state.compensated_reference_rate = wanted, wanted_rate
    return current != unlimited


@njit
def _show_measurement(measurement, output):
    output.hydraulic_force, output.hydraulic_force_rate = measurement[0], measurement[1]
    output.load_force, output.load_force_rate = measurement[2], measurement[3]
    output.pressure_a, output.pressure_b = measurement[4], measurement[5]
    output.piston_position, output.piston_velocity = measurement[6], measurement[7]


@njit
def _show_gains(state, limits, held, output):
    """The gains in force: where commands are late, or for another law, those of the law's safe state."""
    law = law_of(limits, state.law)
    output.proportional_gain = law.base_kp if held else law.base_kp + state.delta_kp
    output.integral_gain = law.base_ki if held else law.base_ki + state.delta_ki


@njit
def _flags(state, late, saturated):
    flags = state.faults
    if state.armed:
        flags |= np.uint32(ARMED)
    if saturated:
        flags |= np.uint32(SATURATED)
    if late:
        flags |= np.uint32(WATCHDOG)
    if state.tripped:
        flags |= np.uint32(TRIPPED)
    if late or not state.filter_fresh:
        flags |= np.uint32(FILTER_STALE)
    return flags
