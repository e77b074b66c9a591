# SPDX-License-Identifier: Apache-2.0
"""Forecast of the control error: the recorded closed loop, simulated on the bench file and on the corrected bench.

::

    f_r, gains, corrections as recorded ──> box, with the law and the box's bench ─────────────> valve current
                                               ^                                                     │
                                               └── sensors with the recording's noise <── plant <────┘
                                                   bench file | corrected | corrected without one cause

The law counts as known if it reproduces the recorded nominal current from the recorded measurements. Every RMSE, the
recorded one included, is that of f_r minus the load cell's reading, over the same seconds: all contain the cell's
noise, as estimated by the diagnosis. A compensated law is run with the recorded f_c, C_1 and C_2, which its host had
fitted to the bench.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from hydro_bridge.bags import is_bag
from hydro_bridge.bags.recording import Bag, RecordingError, read_bag, read_messages, stream_bag
from hydro_core.signals import PLANT_FIELDS, SAMPLE_PERIOD, SAMPLES_PER_STEP, STATE_FIELDS, Flag, FloatArray, Law
from hydro_core.valve_overlap import LEAP, valve_overlap
from hydro_diagnosis.bench_parameters import can_simulate
from hydro_diagnosis.effects.base import EffectHypothesis
from hydro_diagnosis.preprocessing.quality import SATURATION_SHARE
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.report.corrected_bench import corrected_bench
from hydro_diagnosis.report_json import ForecastReport
from hydro_sim.box.box import BoxConfig
from hydro_sim.files.recordings import BOX_TOPIC
from hydro_sim.model import equations as eq
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import TEXTBOOK_STATE_COUNT
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import Sensors
from hydro_sim.simulation.offline import Schedule, simulate

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Problem

MAX_FORECAST_ERROR = 0.2
"""Relative error of a forecast, over the recorded RMSE, beyond which it is reported to miss."""
LAW_STATE_TOPIC = "/hydro/law_state"


@dataclass(frozen=True)
class RecordedLoop:
    """Recorded closed loop of an armed box: bench model, settings and schedule, reference and measured force."""

    recording: str
    box_bench: Bench
    """Bench model of the box's force law."""
    config: BoxConfig
    schedule: Schedule
    reference: FloatArray
    """f_r [N], shape (schedule.samples,)."""
    force: FloatArray
    """Reading of the load cell [N], shape (schedule.samples,)."""
    start: FloatArray
    """Measurement x of the first sample, shape (8,)."""
    scored_samples: slice
    """Samples of the RMSE: recorded ones, once the loop has settled."""

    def rmse(self, force: FloatArray) -> float:
        """RMSE [N] of a load force against the reference."""
        return float(np.sqrt(np.mean(np.square((self.reference - force)[self.scored_samples]))))

    def simulated(self, bench: Bench, sensors: Sensors) -> float:
        """RMSE [N] of the loop on a simulated bench; infinite if its box trips."""
        states = simulate(
            _InitialisedPlant(bench, sensors, self.start), self.box_bench, self.schedule, config=self.config
        )
        return float("inf") if np.any(states["flags"] & Flag.TRIPPED) else self.rmse(states["load_force"])


class _InitialisedPlant(AnalyticPlant):
    """Plant that starts in the state of a measurement x, shape (8,); states without a sensor start at rest."""

    def __init__(self, bench: Bench, sensors: Sensors, start: FloatArray) -> None:
        self._start = start
        super().__init__(bench, settings=sensors)

    def reset(self, seed: int) -> FloatArray:
        super().reset(seed)
        force_h, _, force_l, force_rate, pressure_a, pressure_b, position, velocity = self._start
        self.state["y"][0, :TEXTBOOK_STATE_COUNT] = pressure_a, pressure_b, position, velocity, force_l, force_rate
        self.state["x"][0], self.state["last"][0] = self._start, (force_h, force_l, position)
        return self.measurement()


def forecasts(
    problem: Problem, claims: Sequence[EffectHypothesis], held: Sequence[Segment], paths: Iterable[str | Path]
) -> tuple[list[ForecastReport] | None, str]:
    """Forecasts of the recordings in `held`, or None; with reasons for missing ones. `paths`: of the recordings."""
    if not can_simulate(problem.bench):
        return None, "the bench file does not hold all numbers that a simulation needs"
    where = {name: Path(path) for path in paths for name in (Path(path).name, Path(path).stem, str(Path(path)))}
    found, reasons = [], []
    for name in dict.fromkeys(segment.recording for segment in held):
        longest = max((one for one in held if one.recording == name), key=len)
        try:
            loop = recorded_loop(longest, problem.bench, where.get(name))
            found.append(_forecast(loop, problem, claims))
        except (ValueError, RecordingError) as error:  # also: no C compiler, or numbers that cannot be simulated
            reasons.append(f"{name}: {error}")
    return found or None, "; ".join(reasons)


def _forecast(loop: RecordedLoop, problem: Problem, claims: Sequence[EffectHypothesis]) -> ForecastReport:
    noise, law = problem.sensor_noise, loop.schedule.law.name.lower()
    if missing := {"load_force", "pressure_a", "pressure_b", "piston_position"} - noise.keys():
        raise ValueError(f"the noise of {', '.join(sorted(missing))} is not known from what was fitted")
    sensors = Sensors(
        force_noise=noise["load_force"],
        pressure_noise=float(np.hypot(noise["pressure_a"], noise["pressure_b"]) / np.sqrt(2.0)),
        position_step=float(np.sqrt(12.0) * noise["piston_position"]),
    )
    known = tuple(one for one in claims if one.effect.estimated)
    causes = [one for one in claims if not one.effect.estimated]
    recorded, before = loop.rmse(loop.force), loop.simulated(corrected_bench(problem.bench, known), sensors)
    after = loop.simulated(corrected_bench(problem.bench, claims), sensors) if causes else before
    without = {
        cause.effect.label: before if len(causes) == 1 else
        loop.simulated(corrected_bench(problem.bench, [one for one in claims if one is not cause]), sensors)
        for cause in causes
    }  # fmt: skip
    misses = not abs(after - recorded) <= MAX_FORECAST_ERROR * recorded
    said = f"On {loop.recording}, under the {law} law, your simulation promised {_newtons(before)}, the bench gave "
    said += _newtons(recorded) + (f", the corrected simulation says {_newtons(after)}" if causes else "")
    parts = [f"{_newtons(one)} without {label.replace(':', ' ')}" for label, one in without.items()]
    said += f" ({', '.join(parts)})." if len(parts) > 1 else "."
    if misses:
        most = 100.0 * MAX_FORECAST_ERROR
        said += f" The forecast MISSES what was recorded by more than {most:.0f} %: tune no controller on it."
    return ForecastReport(
        recording=loop.recording, law=law, rmse_recorded=recorded, rmse_bench_file=before, rmse_corrected=after,
        without=without, misses=misses, sentence=said,
    )  # fmt: skip


def _newtons(rmse: float) -> str:
    return f"{rmse:.3g} N" if np.isfinite(rmse) else "a trip of the box"


def recorded_loop(segment: Segment, bench: Bench, path: Path | None = None) -> RecordedLoop:
    """Closed loop of a segment; the box's bench is `bench`, the nominal bench, or one in the recording at `path`.

    That which best reproduces the recorded current is taken. Raises ValueError, its message without a full stop:
    no reference or law is recorded, the armed part is too short, or the law does not reproduce the current.
    """
    if missing := [name for name in STATE_FIELDS if name not in segment.channels]:
        raise ValueError(f"no force law or reference is recorded ({', '.join(missing)})")
    if abs(segment.step - SAMPLE_PERIOD) > 1e-3 * SAMPLE_PERIOD:
        raise ValueError(f"its box does not run at {1.0 / SAMPLE_PERIOD:g} Hz")
    bag = read_bag(path, topics=()) if path is not None and is_bag(path) else None
    law, followed, scales = _law_state(segment, bag)
    armed = np.concatenate(([False], segment.channels["nominal_valve_current"] != 0.0, [False]))
    runs = np.flatnonzero(np.diff(armed.astype(np.int8))).reshape(-1, 2)
    begin, end = max(runs.tolist(), key=lambda run: run[1] - run[0], default=(0, 0))
    spacing = segment.spacing
    begin += (segment.phase - begin) % spacing
    settle = 2.0  # s after which a loop that started at rest has converged to the recorded one, to 0.1 %
    least, most = settle + 1.0, settle + 18.0  # s; 50 ms of computing for a simulation
    end = min(end, begin + round(most / SAMPLE_PERIOD))
    if end - begin < round(least / SAMPLE_PERIOD):
        raise ValueError(f"its box is armed for less than {least:g} s without a gap")
    part = segment.cut(begin, end).channels
    box_bench, config = _box(part, law, followed[begin:end], scales, _box_benches(bench, bag), spacing)
    current, nominal = part["valve_current"][::spacing], part["nominal_valve_current"][::spacing]
    limit = box_bench.valve_current_max
    added = np.where(np.abs(current) < SATURATION_SHARE * limit, current - nominal, 0.0)  # by the filter
    corrected = not np.max(np.abs(added)) < 1e-6 * limit
    schedule = Schedule(
        reference=followed[begin:end],
        gains=np.stack([part["proportional_gain"], part["integral_gain"]], axis=1)[::SAMPLES_PER_STEP],
        seconds=SAMPLE_PERIOD * (end - begin),
        correction=np.asarray(np.repeat(added, spacing)[: end - begin]) if corrected else None,
        law=law,
    )
    return RecordedLoop(
        recording=segment.recording, box_bench=box_bench, config=config, schedule=schedule,
        start=np.array([part[name][0] for name in PLANT_FIELDS]),
        reference=part["reference_force"], force=part["load_force"],
        scored_samples=slice(-(-round(settle / SAMPLE_PERIOD) // spacing) * spacing, None, spacing),
    )  # fmt: skip


def _box_benches(bench: Bench, bag: Bag | None) -> list[Bench]:
    """Candidate benches of the box: the bench file's bench, the nominal one, and those stored in the recording."""
    found, texts = [replace(bench, effects=(), closures=(), learned=None), Bench.nominal()], list[Any]()
    if bag is not None:
        boxes = read_messages(bag.path, BOX_TOPIC) if BOX_TOPIC in bag.topics else iter(())
        texts += [bag.attachments.get("bench.yaml"), *(message.bench for _, message in islice(boxes, 1))]
    for text in filter(None, texts):
        with suppress(ValueError, TypeError, yaml.YAMLError):  # another program's
            found.append(Bench.from_mapping(yaml.safe_load(text)))
    return found


def _law_state(segment: Segment, bag: Bag | None) -> tuple[Law, FloatArray, tuple[float, float]]:
    """Law, the reference it followed, f_c [N] and f_c' [N/s], (n, 2), and C_1, C_2; the paper's if none is recorded."""
    channels, at = segment.channels, segment.phase
    paper = Law.PAPER, np.stack([channels["reference_force"], channels["reference_force_rate"]], axis=1), (1.0, 1.0)
    if bag is None or LAW_STATE_TOPIC not in bag.topics:
        return paper
    for states in stream_bag(bag.path):
        same = np.all([states[name] == channels[name][at] for name in ("load_force", "pressure_a")], axis=0)
        if same.any():
            break
    else:
        raise ValueError("its samples were changed, so that the law's coefficients belong to none")
    numbers = int(states["sequence"][np.argmax(same)]) - at + np.arange(len(segment))
    blocks = (block[np.isin(block["sequence"], numbers)] for block in stream_bag(bag.path, LAW_STATE_TOPIC))
    told = np.concatenate(list(blocks))
    told = told[told["law"] == Law.COMPENSATED]
    if not len(told):
        return paper
    names = ("compensated_reference", "compensated_reference_rate")
    followed = np.stack([np.interp(numbers, told["sequence"], told[name]) for name in names], axis=1)
    scales = float(np.median(told["velocity_compensation"])), float(np.median(told["valve_gain_scale"]))
    return Law.COMPENSATED, followed, scales


def _box(
    channels: Mapping[str, FloatArray], law: Law, followed: FloatArray, scales: tuple[float, float],
    benches: Sequence[Bench], spacing: int,
) -> tuple[Bench, BoxConfig]:  # fmt: skip
    """Belief and settings of the box with which its law best reproduces the recorded nominal current."""
    names = zip(("velocity_compensation", "valve_gain_scale"), scales, strict=True)
    fixed = {f"{name}{end}": scale for name, scale in names for end in ("", "_min", "_max")}
    wide = {f"delta_{gain}_{end}": sign * 500.0 for gain in ("kp", "ki") for end, sign in (("min", -1), ("max", 1))}
    tried: list[tuple[float, int, Bench, BoxConfig]] = []
    for box_bench in benches:
        config = BoxConfig().of_bench(box_bench)
        config = replace(config, compensated=replace(config.compensated, **fixed, **wide), **wide)  # type: ignore[arg-type]
        tried.append((_law_off(channels, followed, scales, box_bench, config, spacing), len(tried), box_bench, config))
    off, _, box_bench, config = min(tried)
    if not off <= MAX_FORECAST_ERROR / 4.0:  # a miss of `MAX_FORECAST_ERROR` is then not due to the law
        raise ValueError(f"the {law.name.lower()} law misses the recorded nominal current by {100.0 * off:.0f} %")
    return box_bench, config


def _law_off(
    channels: Mapping[str, FloatArray], followed: FloatArray, scales: tuple[float, float], box_bench: Bench,
    config: BoxConfig, spacing: int,
) -> float:  # fmt: skip
    """Relative RMS error of the law's nominal current; the initial value of the integral is fitted."""
    n, nominal = box_bench.constants().view(np.recarray)[0], channels["nominal_valve_current"]
    error, missed = followed[:, 0] - channels["load_force"], channels["reference_force"] - channels["load_force"]
    stiff = eq.stiffnesses(n, (n.bulk_modulus,) * 2, eq.clip(channels["piston_position"], 0.0, n.stroke))
    edges = eq.edge_drops(n.supply_pressure, n.tank_pressure, channels["pressure_a"], channels["pressure_b"])
    drops = (np.where(nominal >= 0.0, out, back) for out, back in zip(*edges, strict=True))
    into_a, into_b = (n.valve_gain * eq.signed_root(drop) for drop in drops)
    gain = scales[1] * eq.force_rate(n, stiff, (into_a, -into_b), 0.0)
    gain = np.maximum(gain, config.constants(box_bench)["gain_floor"][0])
    moving = scales[0] * eq.force_rate(n, stiff, (0.0, 0.0), channels["piston_velocity"])
    overlap = valve_overlap(box_bench.effects)
    widths = np.where(nominal < overlap["closing"], overlap["back"], overlap["out"])
    beyond = (nominal - overlap["closing"]) / (LEAP * box_bench.valve_current_max + widths)
    opening = nominal - widths * np.clip(beyond, -1.0, 1.0)
    action = opening * gain + moving - followed[:, 1] - channels["proportional_gain"] * error
    current = channels["valve_current"]
    stopped = (np.abs(current) >= SATURATION_SHARE * box_bench.valve_current_max) & (current * missed > 0.0)
    grown = np.cumsum(np.where(stopped, 0.0, channels["integral_gain"] * missed)) * SAMPLE_PERIOD
    left = (action[1:] - grown[:-1])[spacing - 1 :: spacing]
    off = (left - left.mean()) / gain[spacing::spacing]
    return float(np.sqrt(np.mean(np.square(off)) / np.mean(np.square(nominal[spacing::spacing]))))
