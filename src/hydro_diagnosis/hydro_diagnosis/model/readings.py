# SPDX-License-Identifier: Apache-2.0
"""What the sensors show of simulated states: their response to the recording, and to how far the states leave it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hydro_diagnosis.effects.base import FloatArray, Kinematics
from hydro_diagnosis.model.memory import StepMemory
from hydro_diagnosis.model.window_memory import ColumnMemory, Indices, WindowMemory
from hydro_sim.model import equations as eq
from hydro_sim.model.equations import LOAD_CELL_DAMPING

if TYPE_CHECKING:
    from hydro_diagnosis.model.simulation import Plant


def readings(plant: Plant, states: FloatArray, begins: Indices) -> dict[str, FloatArray]:
    """Return the sensors' readings of simulated states, by channel, shape (length, variants * windows)."""
    length, _, lanes = states.shape
    samples = np.tile(begins, lanes // len(begins))
    at = samples[None, :] + np.arange(length)[:, None]
    x, v, p_a, p_b = states.transpose(1, 0, 2)
    bench, shaken = plant.bench, _accelerations(plant, states, samples)
    true = {
        "piston_position": x,
        "pressure_a": p_a,
        "pressure_b": p_b,
        "hydraulic_force": eq.hydraulic_force(bench, p_a, p_b),
        "load_force": _load(plant, Kinematics(at * plant.model.step, x, v, None, shaken), samples),
    }
    simulated = {"position": x, "velocity": v, "pressure_a": p_a, "pressure_b": p_b, "acceleration": shaken}
    beside = plant.model.beside
    aside = {name: simulated[name] - beside[name][at] for name in simulated if name in beside}
    return {
        name: _shown(plant, name, signal, at, aside) for name, signal in true.items() if name in plant.model.channels
    }


def _accelerations(plant: Plant, states: FloatArray, samples: Indices) -> FloatArray:
    """Acceleration [m/s2] along windows, shape (length, windows), if any claim depends on it; else 0."""
    found = np.zeros_like(states[:, 1])
    memory = StepMemory(plant.model.step)
    memory.begin({key: trace[samples] for key, trace in plant.traces.items()})
    for k in range(len(states) if any(claim.effect.shaken for claim in plant.claims) else 0):
        time = np.asarray(plant.model.segment.start + (samples + k) * plant.model.step)
        spool = plant.spool[np.minimum(samples + k, len(plant.spool) - 1), 0][:, None]
        motion = Kinematics(time, states[k, 0], states[k, 1])
        dry = 0.0 if not plant.sticks else np.sign(motion.velocity) * plant.level(motion) / plant.mass(motion)
        found[k] = plant.rates(states[k], time, spool, memory)[1] - dry
        memory.tick()
    return found


def _load(plant: Plant, motions: Kinematics, samples: Indices) -> FloatArray:
    position, shaken = motions.position, motions.acceleration
    force: FloatArray = eq.spring_force(plant.bench, position)
    acting = plant.loading
    memory = StepMemory(plant.model.step)
    memory.begin({key: trace[samples] for key, trace in plant.traces.items()})
    for k in range(len(position) if acting else 0):
        now = None if shaken is None else shaken[k]
        motion = Kinematics(motions.time[k], position[k], motions.velocity[k], None, now)
        for claim in acting:
            force[k] = claim.effect.load(force[k], motion, plant.bench, memory, claim.values)
        memory.tick()
    return force


def _shown(plant: Plant, name: str, signal: FloatArray, at: Indices, aside: dict[str, FloatArray]) -> FloatArray:
    """The sensor's response to the recording's own signal plus its response to the difference from it.

    A reading that depends on the instant alone, or on a path, is taken where the signal is: it may be curved.

    `aside`: that difference of what stands beside the sensor.
    """
    proxy, record = _proxy(plant, name), plant.model.memory
    apart = signal - proxy[at]
    nothing = np.zeros_like(apart)
    still = ColumnMemory(plant.model.step, dict.fromkeys(aside, nothing))
    memory = ColumnMemory(plant.model.step, aside)
    if name == "load_force" and plant.bench.load_cell_bandwidth is not None:
        cell = plant.bench.load_cell_bandwidth, LOAD_CELL_DAMPING
        proxy, apart = record.low_pass(name, proxy, *cell), memory.low_pass(name, apart, *cell)
    for claim in plant.claims:
        shown = claim.effect.measure(name, proxy, record, claim.values)
        if shown is proxy:
            continue
        if claim.effect.instant:
            both = {key: plant.model.beside[key][at] + aside.get(key, 0.0) for key in plant.model.beside}
            there = WindowMemory(plant.model.step, both, record.traces, at)
            apart = claim.effect.measure(name, proxy[at] + apart, there, claim.values) - shown[at]
        else:
            with_it, without = (
                claim.effect.measure(name, one, past, claim.values) for one, past in ((apart, memory), (nothing, still))
            )
            apart = with_it - without
        proxy = shown
    if name == "piston_position":
        apart = apart + (plant.channels[name] - plant.model.channels[name])[at]
    return proxy[at] + apart


def _proxy(plant: Plant, name: str) -> FloatArray:
    if name == "piston_position":
        return plant.model.channels[name]
    if name == "load_force":
        return plant.model.spring_force(plant.bench, plant.claims, plant.model.recorded)
    p_a, p_b = (plant.model.smooth(plant.model.true_signal("pressure_" + chamber, plant.claims)) for chamber in "ab")
    if name == "hydraulic_force":
        force: FloatArray = eq.hydraulic_force(plant.bench, p_a, p_b)
        return force
    return p_a if name == "pressure_a" else p_b
