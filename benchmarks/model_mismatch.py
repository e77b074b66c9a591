# SPDX-License-Identifier: Apache-2.0
"""What the filter does where its model is not this bench's: false alarms, time until told, and what the force does.

Off-line, sample by sample, on the emulated bench and the learned simulation: box, guard (opened to all that the box
takes), filter. The tables of filter_figures.md:

alarms     benches that are what was learned, for an hour: references and gains at random, other noise for each
changes    a bench that changes while it runs, the filter starting with the shipped model: when it is told, and the
           error from a second after the change on; beside fixed (90, 15) without a filter
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._report import parser
from benchmarks._truths import truth_fleet
from benchmarks.paper.validation import GAINS
from hydro_bridge.safety.guard import GuardSettings
from hydro_core.cli.console import Table, command, progress
from hydro_core.signals import (
    PLANT_FIELDS,
    SAMPLE_PERIOD,
    SAMPLES_PER_STEP,
    STATE_FIELDS,
    CorrectionStatus,
    Flag,
    FloatArray,
    ReferenceSignal,
    StateArray,
    Waveform,
)
from hydro_filter.controller.loop_filter import EQUATIONS, LoopFilter, default_filter
from hydro_filter.model.loop import make_samples
from hydro_filter.model.records import new_memories, new_monitors, run_monitor
from hydro_policy.envs.vector_env import VectorBench, vector_filter
from hydro_policy.evaluation.controllers import Controller, FixedGains, policy_controller
from hydro_policy.supervision.plant_supervisor import FALLBACK_GAIN_CHANGES
from hydro_sim.emulator.truth.config import profile
from hydro_sim.files.learned_bench import make_plant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import Plant
from tests.changing_plant import ChangingPlant, modified_truth
from tests.offline_graph import OfflineGraph

CHANGES: Mapping[str, Mapping[str, Any]] = {
    **{f"spring {k:g} kN/m": {"bench": {"spring_stiffness": 1e3 * k}} for k in (10.0, 14.0, 28.0, 30.0, 40.0, 50.0)},
    **{f"supply {p:g} MPa": {"bench": {"supply_pressure": 1e6 * p}} for p in (10.0, 13.0)},
    "valve gain -25 %": {"effects": {"valve_gain": {"ratio": 0.75}}},
    "piston area +30 %": {"bench": {"piston_area": 2.6e-4}},
}
"""What the learned bench (20 kN/m, 16 MPa) becomes."""
SHIPPED = Path(str(resources.files("hydro_policy") / "data" / "pretrained_wide" / "policy.safetensors"))
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)
CHANGE, SETTLED, SECONDS = 2500, 1000, 6.5
"""Samples until the change, and from there to the error's begin; s of a run."""
WIDE = GuardSettings(
    delta_kp_min=-55.0, delta_kp_max=285.0, delta_ki_min=-25.0, delta_ki_max=95.0, require_filter=False
)
"""All that the box takes."""
COLUMNS = {
    "bench": "",
    "gains": "asked for",
    "filter": "whether there is one",
    "told": "ms from the change to the first MISMATCH",
    "rmse": "N, of f_r - f_l from a second after the change on",
    "worst": "N, RMSE of the worst second from the change on",
    "peak": "N, largest |f_r - f_l| from the change on",
    "jump": "mA, largest change of the current in 1 ms",
    "tripped": "whether the box did",
}


def play(plant: Plant, controller: Controller, corrector: LoopFilter | None) -> tuple[StateArray, FloatArray]:
    """Samples of a sine, shape (n,), and each one's `CorrectionStatus`, shape (n,), until the box trips.

    Under MISMATCH the gains are `FALLBACK_GAIN_CHANGES`, as trainer and evaluate have it.
    """
    graph = OfflineGraph(plant, Bench.nominal(), guard=WIDE, corrector=corrector)
    controller.reset()
    if corrector is not None:
        corrector.reset()
    graph.publish_reference(SINE)
    records, statuses = [], []
    for k in range(round(SECONDS / SAMPLE_PERIOD)):
        graph.arm(k > 0)
        records.append(graph.sample().copy())
        statuses.append(int(graph.answer.status))
        if int(records[-1]["flags"]) & Flag.TRIPPED:
            break
        if k % SAMPLES_PER_STEP == 0:
            asked = controller.gains(np.array([records[-1][name] for name in STATE_FIELDS]))
            graph.publish_gains(*(FALLBACK_GAIN_CHANGES if statuses[-1] == CorrectionStatus.MISMATCH else asked), 0)
    return np.array(records), np.array(statuses, float)


def outcome(states: StateArray, statuses: FloatArray) -> dict[str, Any]:
    """Figures of a run by `COLUMNS`."""
    at = np.flatnonzero(statuses == CorrectionStatus.MISMATCH)
    if len(at) and at[0] < CHANGE:
        raise AssertionError("told before the change")
    error = (states["reference_force"] - states["load_force"])[CHANGE:]
    if not len(error):
        error = np.array([np.nan])
    square = np.convolve(error**2, np.full(min(1000, len(error)), 1.0 / min(1000, len(error))), "valid")
    return {
        "told": 1e3 * float(at[0] - CHANGE) * SAMPLE_PERIOD if len(at) else np.nan,
        "rmse": float(np.sqrt(np.mean(error[SETTLED:] ** 2))) if len(error) > SETTLED else np.nan,
        "worst": float(np.sqrt(square.max())),
        "peak": float(np.abs(error).max()),
        "jump": 1e3 * float(np.abs(np.diff(states["valve_current"][CHANGE:])).max(initial=0.0)),
        "tripped": bool(int(states["flags"][-1]) & Flag.TRIPPED),
    }


def changes(names: list[str]) -> Table:
    """The second table."""
    table, watched = Table(COLUMNS, title="A bench that changes while it runs"), default_filter()
    policy = policy_controller(SHIPPED)
    policy.name = "wide policy"
    runs: list[tuple[Controller, LoopFilter | None]] = [(FixedGains(90.0, 15.0), None)]
    runs += [(asking, watched) for asking in (FixedGains(250.0, 15.0), FixedGains(300.0, 30.0), policy)]
    for name in progress(names, label="changes", unit="bench"):
        plant = ChangingPlant([modified_truth({}), modified_truth(CHANGES[name])], [CHANGE])
        for asking, corrector in runs:
            found = outcome(*play(plant, asking, corrector))
            table.add(bench=name, gains=asking.name, filter="yes" if corrector else "no", **found)
    return table


NAMES = ("wide", "wide-slow", "switched-slow", "switched", "unstable-slow", "high", "stable", "base")
"""Of the gains, in turn: K_p from -40 to 300."""
WAVEFORMS = (Waveform.SINE, Waveform.SINE, Waveform.MULTISINE, Waveform.SMOOTH_STEP, Waveform.HOLD)
"""Of the references, in turn: within +-350 N and 3 Hz."""
BENCHES = 48
ALARM = 50.0
"""HYDRO_ALARM of firmware/hydro/monitor.h."""


def alarms(minutes: float, seed: int) -> Table:
    """The table, of both plants."""
    columns = {"plant": "", "minutes": "of bench time", "alarms": "samples", "tripped": "benches"}
    sums = dict.fromkeys(EQUATIONS, "largest sum; 50 is told")
    table = Table(columns | sums, title="Nothing is wrong: false alarms")
    fleets = {"emulator": truth_fleet([profile("default")] * BENCHES),
              "sim": VectorBench([Bench.nominal()] * BENCHES, [make_plant() for _ in range(BENCHES)])}  # fmt: skip
    for plant, fleet in fleets.items():
        table.add(plant=plant, **run(plant, fleet, minutes, seed))
    return table


def run(plant: str, fleet: VectorBench, minutes: float, seed: int) -> dict[str, float]:
    """So many minutes of bench time, over benches with a noise, a reference and gains of their own."""
    rng, bench = np.random.default_rng(seed), Bench.nominal()
    fleet.filters = vector_filter("learned", bench, BENCHES)
    steps = max(round(60.0 * minutes / BENCHES / (SAMPLES_PER_STEP * SAMPLE_PERIOD)), 1)
    gains = np.stack(
        [GAINS[NAMES[i % len(NAMES)]].draw_gains(seed * BENCHES + i, steps / 100.0) for i in range(BENCHES)]
    )
    changes = gains - (fleet.config.base_kp, fleet.config.base_ki)
    for i in range(BENCHES):
        amplitude, offset, frequency = rng.uniform((10.0, -50.0, 0.2), (300.0, 50.0, 3.0)).tolist()
        signal = ReferenceSignal(
            waveform=WAVEFORMS[i % len(WAVEFORMS)], amplitude=amplitude, offset=offset, frequency=frequency
        )
        fleet.reset(i, signal, seed * BENCHES + i)
    loop = default_filter(bench).record["loop"]
    watched = [(new_memories(), new_monitors()) for _ in range(BENCHES)]
    highest, alarms = np.zeros(len(EQUATIONS)), 0
    tripped = np.zeros(BENCHES, bool)
    for k in progress(range(steps), label=f"no alarm, {plant}", unit="step"):
        samples = fleet.step(changes[:, k])
        x = np.stack([samples[name] for name in PLANT_FIELDS], axis=-1)
        for i, (memory, monitor) in enumerate(watched):
            seen = make_samples(x[i], current=samples["valve_current"][i])
            sums = run_monitor(loop, seen, memory, monitor).max(axis=-1)
            highest = np.maximum(highest, sums.max(axis=0))
            alarms += int((sums > ALARM).any(axis=-1).sum())
        tripped |= (samples["flags"][:, -1] & int(Flag.TRIPPED)) != 0
    spent = steps * BENCHES * SAMPLES_PER_STEP * SAMPLE_PERIOD / 60.0
    sums = dict(zip(EQUATIONS, highest.tolist(), strict=True))
    return {"minutes": spent, "alarms": alarms, "tripped": int(tripped.sum()), **sums}


@command(ValueError)
def main() -> None:
    """Measure, print, write."""
    options = parser("model_mismatch", __doc__)
    options.add_argument("what", nargs="?", default="changes", choices=("alarms", "changes"), help="default changes")
    options.add_argument("--minutes", type=float, default=60.0, help="of alarms, each plant, default 60")
    options.add_argument("--seed", type=int, default=1, help="of alarms: noise, references and gains, default 1")
    options.add_argument("--bench", nargs="+", default=list(CHANGES), choices=CHANGES, help="changes, default all")
    asked = options.parse_args()
    (alarms(asked.minutes, asked.seed) if asked.what == "alarms" else changes(asked.bench)).show(asked.json)


if __name__ == "__main__":
    main()
