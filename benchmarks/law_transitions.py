# SPDX-License-Identifier: Apache-2.0
"""f_r, f_c and f of the compensated law where something happens: python -m benchmarks.law_transitions --plot FILE.

The emulator's default truth with its box, guard and estimator, without clock and serial line. For each event the
largest changes within a sample, in the second that begins with it, while the box is armed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from hydro_bridge.cli.console import Table, add_json_argument, command
from hydro_bridge.safety.guard import CommandGuard
from hydro_bridge.signals import SAMPLE_PERIOD, Command, Flag, FloatArray, ReferenceSignal, Waveform
from hydro_policy.compensation.live import LiveCompensation
from hydro_sim.box.box import BoxConfig
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.truth.config import profile
from hydro_sim.plotting import BLUE, GRAY, GREEN, ORANGE, RED, figure, legend

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)
STEPS = ReferenceSignal(waveform=Waveform.SMOOTH_STEP, amplitude=200.0, frequency=0.5)
HOLD = ReferenceSignal(offset=100.0)
EVENTS = {
    0.1: "arming", 6.5: "none, a sine of 300 N", 7.85: "fade to smooth steps", 10.85: "edge of a step",
    12.5: "fade to a hold", 14.5: "fade to a sine", 18.7: "estimator killed", 21.2: "estimator back",
    25.1: "no commands for 100 ms", 27.3: "no commands for 300 ms: trip", 29.0: "arming anew", 31.2: "disarm",
}  # fmt: skip
"""s, what begins then."""
END = 32.0
REFERENCES = {0.0: SINE, 7.85: STEPS, 12.5: HOLD, 14.5: SINE}
SILENT = ((25.1, 25.2), (27.3, 27.6))
KILLED = (18.7, 21.2)
DISARMED = ((0.0, 0.1), (28.5, 29.0), (31.2, END))


def run() -> dict[str, FloatArray]:
    """Play all of it; columns by name, one value per sample."""
    config = BoxConfig()
    machine, guard = Machine(profile("default"), box=config), CommandGuard()
    live = LiveCompensation(config.compensated)
    guard.offer(config.compensated)
    rows = []
    for k in range(round(END / SAMPLE_PERIOD)):
        time = k * SAMPLE_PERIOD
        armed = not any(begin <= time < end for begin, end in DISARMED)
        if not any(begin <= time < end for begin, end in SILENT):
            guard.set_arm(armed)
            for begin, signal in REFERENCES.items():
                if abs(time - begin) < 0.5 * SAMPLE_PERIOD:
                    guard.set_reference(signal)
            machine.receive(guard.command(time) if k else Command())
        sample, law = machine.tick(), machine.law_state
        sequence, flags = int(sample["sequence"]), int(sample["flags"])
        if not KILLED[0] <= time < KILLED[1]:
            live.on_law_state(sequence, law.law, law.compensated_reference)
            live.on_sample(sequence, float(sample["load_force"]), flags, float(sample["reference_force_rate"]))
            if k % 10 == 0:
                guard.set_law(live.command, time)
                guard.set_gains(0.0, 0.0, time)
        forces = sample["reference_force"], law.compensated_reference, law.compensated_reference_rate
        rows.append((time, *forces, sample["load_force"], sample["valve_current"], flags, *law.coefficients))
    names = ("time", "f_r", "f_c", "f_c'", "f", "u", "flags", "a_0", "a_1", "a_2", "a_3")
    return dict(zip(names, np.array(rows, float).T, strict=True))


def table(found: dict[str, FloatArray]) -> Table:
    """Largest changes within a sample in the second after each event."""
    columns = {"event": "", "f_c": "N", "f_c beyond f_c'": "N, less what f_c' says", "u": "mA", "f_r - f": "N, RMS"}
    made = Table(columns, title="Largest change within a sample, while armed")
    armed = found["flags"].astype(int) & Flag.ARMED != 0
    both = armed[1:] & armed[:-1]
    jump, rate = np.abs(np.diff(found["f_c"])), np.abs(found["f_c'"]) * SAMPLE_PERIOD
    beyond, current = jump - np.maximum(rate[1:], rate[:-1]), 1e3 * np.abs(np.diff(found["u"]))
    for begin, name in EVENTS.items():
        here = both & (found["time"][1:] >= begin - 1e-9) & (found["time"][1:] < begin + 1.0)
        if not here.any():
            continue
        error = (found["f_r"] - found["f"])[1:][here]
        peaks = [float(values[here].max()) for values in (jump, np.maximum(beyond, 0.0), current)]
        figures = [*peaks, float(np.sqrt(np.mean(error**2)))]
        made.add(**dict(zip(columns, [name, *(float(f"{each:.2f}") for each in figures)], strict=True)))
    return made


def draw(found: dict[str, FloatArray], path: Path) -> None:
    """Forces, coefficients and current over all events."""
    time = found["time"]
    panels = figure(path, 4, size=(11.0, 8.5), sharex=True, height_ratios=(3, 2, 2, 1.5))
    with panels as (_, (force, apart, shape, current)):
        for name, color in (("f_c", ORANGE), ("f", BLUE), ("f_r", GRAY)):
            force.plot(time, found[name], color=color, label=name, linestyle="--" if name == "f_r" else "-")
        for one, other, color in (("f_c", "f_r", ORANGE), ("f_r", "f", BLUE)):
            apart.plot(time, found[one] - found[other], color=color, label=f"{one} - {other}")
        for name, scale, unit, color in (
            ("a_0", 1e2, "%", GRAY), ("a_1", 1e3, "ms", BLUE), ("a_2", 1e5, "1e-5 s²", RED), ("a_3", 1.0, "N", GREEN),
        ):  # fmt: skip
            shape.plot(time, scale * found[name], color=color, label=f"{name} [{unit}]")
        current.plot(time, 1e3 * found["u"], color=BLUE)
        force.set_ylabel("force [N]")
        apart.set_ylabel("difference [N]")
        shape.set_ylabel("coefficients")
        current.set(ylabel="current [mA]", xlabel="time [s]", xlim=(0.0, END))
        for begin, name in EVENTS.items():
            for panel in (force, apart, shape, current):
                panel.axvline(begin, color="#d0d4d8", linewidth=0.8, zorder=0)
            force.text(begin, 1.02, name, rotation=35, fontsize=7, transform=force.get_xaxis_transform())
        for panel in (apart, shape):
            legend(panel)
        force.legend(loc="lower left", ncols=3)


@command(ValueError, OSError)
def main() -> None:
    """Run, print, draw."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.law_transitions", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False,
    )  # fmt: skip
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw it there")
    add_json_argument(parser)
    asked = parser.parse_args()
    found = run()
    table(found).show(asked.json)
    if asked.plot:
        draw(found, asked.plot)


if __name__ == "__main__":
    sys.exit(main())
