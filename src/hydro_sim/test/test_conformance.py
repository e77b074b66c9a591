# SPDX-License-Identifier: Apache-2.0
"""The conformance cases on the box and on boxes that are broken on purpose, each run in step with its bench."""

from __future__ import annotations

import re
import shutil
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_bridge.conformance.command import FAIL, INCONCLUSIVE, LEFT_OUT, PASS, Run
from hydro_bridge.conformance.host import Host, SilenceError
from hydro_sim.box import firmware
from hydro_sim.box.box import BoxConfig
from hydro_sim.box.firmware import Precision
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.truth import plant as truth
from hydro_sim.emulator.truth.config import TruthBench, profile
from hydro_sim.emulator.truth.effects import Effects, ValveDeadband
from hydro_sim.model.bench import Bench
from tests.checks import compiled

NOMINAL = Bench.nominal()
FIRMWARE = Path(__file__).resolve().parents[3] / "firmware"


class InStep:
    """A box and its bench as a line: each read is one sample of theirs, and no time passes otherwise.

    `delay`: samples that what the host sends is on its way.
    """

    pseudo_terminal = False

    def __init__(self, machine: Machine, delay: int = 0) -> None:
        self.machine, self._sent, self._under_way = machine, b"", deque([b""] * delay)

    def clock(self) -> float:
        return self.machine.time

    def write(self, frame: bytes) -> bool:
        self._sent += frame
        return True

    def read(self, timeout: float) -> bytes:
        self._under_way.append(self._sent)
        self._sent = b""
        self.machine.box.feed(self._under_way.popleft())
        self.machine.tick()
        return self.machine.box.frames()


class Corrupt(InStep):
    """A line on which no check sum holds."""

    def read(self, timeout: float) -> bytes:
        return re.sub(rb"[^\0]\0", lambda last: bytes((last[0][0] % 255 + 1, 0)), super().read(timeout))


def machine_of(
    bench: Bench = NOMINAL, effects: Effects | None = None, precision: Precision = "double", **settings: Any
) -> Machine:
    own = {name: value for name, value in bench.to_mapping().items() if hasattr(TruthBench, name)}
    plant = replace(profile("nominal"), bench=TruthBench(**own), effects=effects or Effects())
    return Machine(plant, bench, BoxConfig(**settings).of_bench(bench), precision=precision, epoch=3)


def judged(line: InStep, *names: str, moving: bool = True, bench: Bench = NOMINAL) -> dict[str, tuple[str, str]]:
    """Outcome and finding of the cases whose names begin so, of all if there are none."""
    rows = Run(lambda: Host(line, line.clock, bench.to_mapping(), moving), names).start()
    return {row["case"]: (row["result"], row["found"]) for row in rows}


def scaled(times: float) -> Bench:
    extensive = ("piston_area", "valve_nominal_flow", "dead_volume_a", "dead_volume_b", "moving_mass",
                 "viscous_friction", "spring_stiffness")  # fmt: skip
    return replace(NOMINAL, **{name: times * getattr(NOMINAL, name) for name in extensive})


BOXES: dict[str, dict[str, Any]] = {
    "nominal": {},
    "paper": {"integral": "paper"},
    "single": {"precision": "single"},
    "hydraulic force": {"feedback": "hydraulic"},
    "a fifth of the bench": {"bench": scaled(0.2)},
    "ten times the bench": {"bench": scaled(10.0)},
    "a line that takes 15 ms": {"delay": 15},
    "a known overlap of the valve": {
        "bench": replace(NOMINAL, effects=({"id": "valve_deadband", "parameters": {"half_width": 2.5e-4}},)),
        "effects": Effects(valve_deadband=ValveDeadband(half_width=2.5e-4)),
    },
}


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=[pytest.mark.study] if "ten times" in one else []) for one in BOXES]
)
def test_the_box_passes_every_case(name: str) -> None:
    """The time that a line takes is not held against it."""
    words = dict(BOXES[name])
    line = InStep(machine_of(**{key: value for key, value in words.items() if key != "delay"}), words.get("delay", 0))
    found = judged(line, bench=words.get("bench", NOMINAL))
    assert {case: result for case, result in found.items() if result[0] != PASS} == {}
    assert len(found) >= 33


def test_a_right_box_with_an_overlap_of_its_valve_fails_nowhere() -> None:
    found = judged(InStep(machine_of(effects=Effects(valve_deadband=ValveDeadband(half_width=2.5e-4)))))
    assert {case for case, (outcome, _) in found.items() if outcome != PASS} <= {"law.sign"}
    assert found["law.sign"][0] in (PASS, INCONCLUSIVE)


def test_a_box_whose_frames_cannot_be_read_is_told_so_once() -> None:
    told = r"\d+ bytes came and no frame in them for \d+ s: \d+ pieces with a wrong CRC"
    with pytest.raises(SilenceError, match=told):
        judged(Corrupt(machine_of()), "framing.stream", "hello.answered")


def test_what_a_box_does_not_tell_is_left_out_or_noted() -> None:
    machine = machine_of()
    for name in ("force_rate_age", "velocity_age", "digest"):
        machine.box.settings[name] = 0
    assert judged(InStep(machine), "measured.rates", "hello.bench") == {
        "measured.rates": (LEFT_OUT, "DETAILS do not tell the ages of the rates"),
        "hello.bench": (LEFT_OUT, "its digest is not told: valve_current_max alone agrees"),
    }


def test_without_moving_nothing_arms_and_the_piston_rests() -> None:
    machine = machine_of()
    before = float(machine.plant.chain[0]["clean"][6])
    found = judged(InStep(machine), moving=False)
    left_out = {case for case, (outcome, _) in found.items() if outcome == LEFT_OUT}
    assert all(outcome in (PASS, LEFT_OUT) for outcome, _ in found.values())
    assert left_out == {case for case, (_, why) in found.items() if "--moving" in why} and "law.sign" in left_out
    assert abs(float(machine.plant.chain[0]["clean"][6]) - before) < 1e-5


BROKEN: dict[str, tuple[str, str, str, str]] = {
    "takes old commands": ("guard.h", "order.old", " || ahead >= 0x80000000u", ""),
    "takes repeated commands": ("guard.h", "order.old", "ahead == 0 || ", ""),
    "watchdog after 60 ms": ("arming.h", "watchdog.hold watchdog.trip order.old hello.safe",
        "age > config->hold_timeout", "age > config->hold_timeout + 0.01"),
    "trips after 150 ms": ("arming.h", "watchdog.trip",
        "age > config->trip_timeout", "age > config->trip_timeout - 0.05"),
    "arms without a disarm": ("arming.h", "arm.needs_a_disarm",
        "arming->disarm_seen;\n    arming->tripped = !arming->disarm_seen", "true"),
    "does not clamp K_p": ("guard.h", "clamp.gains refused.counted",
        "law->delta_kp_min, law->delta_kp_max", "HYDRO_R(-1e9), HYDRO_R(1e9)"),
    "keeps the gain where none is given": ("guard.h", "clamp.gains compensated.shaping",
        "broken ? safe", "broken ? guard->delta_kp"),
    "forgets the reference's phase": ("reference.h", "reference.sine", "turned(angle + signal->phase", "turned(angle"),
    "a weight of the multisine is another": ("reference.h", "reference.multisine compensated.shaping",
        "0.44789526038332517", "0.25"),
    "edges of a quarter of a period": ("reference.h", "reference.smooth_step reference.fade",
        "HYDRO_EDGE 0.125", "HYDRO_EDGE 0.25"),
    "changes break a fade off": ("reference.h", "reference.fade", "time - reference->fade_start >= HYDRO_FADE && ", ""),
    "a HELLO does not disarm": ("box.h", "arm.off hello.safe", "= box->has_now = true", "= true"),
    "the paper's integral, called bumpless": ("force_law.h", "law.nominal", "HYDRO_BUMPLESS 2u", "HYDRO_BUMPLESS 77u"),
    "the correction is lost": ("box.h", "law.current watchdog.trip", " + box->guard.delta_u", ""),
    "late commands keep their gains": ("box.h", "watchdog.hold watchdog.trip compensated.safe",
        "held ? law->base_kp : ", ""),
    "accepts frames without their check sum": ("stream.h", "framing.damaged",
        "!= hydro_read32(data + count - 4)", "!= hydro_crc(data, count - 4)"),
    "HELLO without a sequence": ("box.h", "hello.answered", "if (box->hellos == 0) {", "if ((box->hellos = 0) == 1) {"),
    "counts samples by two": ("box.h", "framing.stream framing.garbage",
        "box->sequence++", "box->sequence++ * 2"),
    "forgets FILTER_STALE": ("arming.h", "idle.gains arm.arms hello.safe watchdog.hold watchdog.trip",
        "late || !arming->filter_fresh", "late"),
    "takes frames of versions to come": ("stream.h", "framing.damaged",
        "0u : HYDRO_VERSION", "0u : data[0] > HYDRO_VERSION ? data[0] : HYDRO_VERSION"),
    "does not tell the form of its integral": ("protocol.h", "hello.answered", "(uint8_t)config->integral_form", "0"),
    "tells another bench": ("protocol.h", "hello.bench", "config->digest, sizeof config->digest", '"000000000000", 12'),
    "a HELLO is not the begin of a conversation": ("box.h", "hello.safe", "box->guard.heard = false;", ""),
    "a HELLO disarms and is no heartbeat": ("box.h", "hello.safe",
        "command->filter_fresh, time);", "command->filter_fresh, box->greeted ? box->arming.received_at : time);"),
    "sends no DETAILS": ("box.h", "hello.answered", "count += hydro_encode_details", "(void)hydro_encode_details"),
    "its clock shakes while it is disarmed": ("protocol.h", "clock.pace",
        "1e6 + 0.5", "1e6 + 0.5 + (~sample->flags & sample->sequence & 1u) * 300.0"),
    "shows the correction while it is disarmed": ("box.h", "idle.values",
        "if (!box->arming.armed) {", "if (!box->arming.armed) {\n        values[HYDRO_NOMINAL] = box->guard.delta_u;"),
    "whole integral gains only": ("box.h", "idle.gains", "box->guard.delta_ki", "(hydro_real)(int)box->guard.delta_ki"),
    "newer is a quarter of the circle": ("guard.h", "order.wraps", "0x80000000u", "0x40000000u"),
    "looks at the watchdog before it takes the command": ("box.h", "watchdog.hold watchdog.trip hello.safe order.old",
        "    hydro_box_receive(box, time);\n    late = hydro_watchdog(&box->arming, config, time);",
        "    late = hydro_watchdog(&box->arming, config, time);\n    hydro_box_receive(box, time);"),
    "refuses the range itself": ("guard.h", "refused.counted", "+ offset > force_range", "+ offset >= force_range"),
    "the hydraulic force is 200 N off": ("protocol.h", "measured.units", "hydro_write32(at, sample->flags);",
        "hydro_write32(at, sample->flags);\n    hydro_write32(at - 56, hydro_bits(sample->values[0] + HYDRO_R(200)));"),
    "tells twice the age of its rates": ("protocol.h", "measured.rates",
        "config->force_rate_age", "2 * config->force_rate_age"),
    "FILTER_STALE as long as it is armed": ("arming.h", "arm.arms",
        "late || !arming->filter_fresh", "late || arming->armed || !arming->filter_fresh"),
    "disarms a sample late": ("box.h", "arm.off watchdog.trip",
        "!box->arming.armed", "!box->arming.armed && (box->sample.flags & HYDRO_ARMED) == 0"),
    "a refused reference becomes a hold": ("guard.h", "reference.refused",
        "guard->refused[1]++;", "guard->refused[1]++;\n        wanted->waveform = HYDRO_HOLD;"),
    "a correction stops the integral": ("box.h", "law.nominal", "unlimited - current", "nominal - current"),
    "LAW tells a safe C_1 beyond its limits": ("protocol.h", "compensated.told compensated.safe compensated.shaping",
        "law->safe[5]", "law->high[5] + 1"),
    "coefficients jump": ("force_law.h", "compensated.shaping compensated.safe", "-step, step", "-1e9, 1e9"),
    "f_c' lacks f_r''''": ("force_law.h", "compensated.shaping compensated.safe", "wave->fourth}", "HYDRO_R(0)}"),
    "f_c lacks f_r'''": ("force_law.h", "compensated.shaping compensated.safe", "HYDRO_R(1), wave->third}",
        "HYDRO_R(1), HYDRO_R(0)}"),
    "the integral is of f_c - f": ("box.h", "compensated.nominal", "wave.value - force, values[HYDRO_KI]",
        "error, values[HYDRO_KI]"),
    "coefficients stay where commands are late": ("box.h", "compensated.safe", "held ? law->safe : ", ""),
    "f_c has no limit": ("force_law.h", "compensated.limit",
        "hydro_clamp(value, -law->reference_max, law->reference_max)", "value"),
    "C_2 is left out": ("force_law.h", "compensated.nominal", "scales[1] * ", ""),
}  # fmt: skip
"""What is broken: file, the cases that must fail and no others, text, and what stands there instead."""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(FIRMWARE, tmp_path_factory.mktemp("broken") / "firmware"))


@pytest.fixture
def broken(copy: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Machine]:
    """Build a box that is broken as `BROKEN` says."""

    def build(name: str) -> Machine:
        file, _, text, instead = BROKEN[name]
        path, library = copy / "hydro" / file, copy / f"{list(BROKEN).index(name)}.so"
        whole = path.read_text()
        assert whole.count(text) == 1, "what is to be broken has changed"
        path.write_text(whole.replace(text, instead))
        try:
            compiled(copy / "hydro_box.c", library, "-O2", "-w", "-fPIC", "-shared")
        finally:
            path.write_text(whole)
        monkeypatch.setattr(firmware, "library_path", lambda precision: library)
        for kept in ("library", "function_addresses"):
            monkeypatch.setattr(firmware, kept, cache(getattr(firmware, kept).__wrapped__))
        return machine_of()

    return build


TRIED = [*(pytest.param(one, False, marks=pytest.mark.slow) for one in list(BROKEN)[::5]),
         *(pytest.param(one, True, marks=pytest.mark.study) for one in BROKEN)]  # fmt: skip


@pytest.mark.parametrize(("name", "all_cases"), TRIED)
def test_a_broken_box_fails_where_it_is_broken(broken: Callable[[str], Machine], name: str, all_cases: bool) -> None:
    wanted = BROKEN[name][1].split()
    found = judged(InStep(broken(name)), *([] if all_cases else wanted))
    assert {case for case, (outcome, _) in found.items() if outcome == FAIL} == {*wanted}, found


def test_each_case_fails_on_a_box_that_is_broken_there() -> None:
    seen = {"law.sign"}.union(*(wanted.split() for _, wanted, *_ in BROKEN.values()))
    assert seen == judged(InStep(machine_of()), moving=False).keys()


class Unconnected(Machine):
    """A bench whose valve does not follow its current, or the wrong way round."""

    current, sign = 0.0, 0.0
    """A, and the factor on the box's current, that it follows."""

    def tick(self) -> np.void:
        sample = self.box.tick(self.plant.measurement(), self.time)
        current = self.current + self.sign * float(sample["valve_current"])
        truth.advance_sample(*self.plant.records, self.plant.work, self.plant.noise.row(), current)
        self.samples += 1
        return sample


def test_a_bench_that_drifts_to_its_stop_passes_no_case_that_it_did_not_play() -> None:
    machine = Unconnected(profile("nominal"))
    machine.current = 2e-3
    for outcome, found in judged(InStep(machine), "law.sign", "reference.sine").values():
        assert outcome == FAIL and "it tripped at" in found and "limit of 700 N" in found


def test_a_valve_the_wrong_way_round_fails_the_sign() -> None:
    machine = Unconnected(profile("nominal"))
    machine.sign = -1.0
    assert judged(InStep(machine), "law.sign")["law.sign"][0] == FAIL


@pytest.mark.parametrize(("pseudo_terminal", "outcome"), [(True, PASS), (False, FAIL)])
def test_a_slow_clock_is_a_fault_but_on_a_pseudo_terminal(pseudo_terminal: bool, outcome: str) -> None:
    """On a busy machine an emulator is as slow as the machine."""
    line = InStep(machine_of())
    line.pseudo_terminal = pseudo_terminal
    (row,) = Run(lambda: Host(line, lambda: 1.06 * line.clock()), ["clock.pace"]).start()
    assert row["result"] == outcome
