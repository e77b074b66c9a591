# SPDX-License-Identifier: Apache-2.0
"""The conformance cases on the box and on boxes that are broken on purpose, each run in step with its bench."""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_bridge.conformance.command import (
    FAIL,
    LEFT_OUT,
    NOT_JUDGED,
    PASS,
    Result,
    parse_cases,
    run_cases,
    select_cases,
    shipped_cases,
)
from hydro_bridge.conformance.host import Host, NoFrameError
from hydro_core.errors import UserError
from hydro_sim.box import firmware
from hydro_sim.box.box import BoxConfig
from hydro_sim.box.firmware import Precision
from hydro_sim.emulator.line.faults import LinkFaults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.truth import plant as truth
from hydro_sim.emulator.truth.config import TruthBench, profile
from hydro_sim.emulator.truth.effects import Effects, LoadCellBias
from hydro_sim.model.bench import Bench
from tests.checks import compiled

NOMINAL = Bench.nominal()
FIRMWARE = Path(__file__).resolve().parents[3] / "firmware"


class InStep:
    """A box and its bench as a line: each read is one sample of theirs, and no time passes otherwise."""

    def __init__(self, machine: Machine, link: BoxLink, memory: Any) -> None:
        self.machine, self.link, self.memory = machine, link, memory

    def clock(self) -> float:
        return self.machine.time

    def write(self, frame: bytes) -> bool:
        self.memory.down += frame
        return True

    def read(self, timeout: float) -> bytes:
        now = self.machine.time
        self.link.poll(now)
        self.machine.tick()
        self.link.send(now)
        data, self.memory.up = self.memory.up, b""
        return data


class Delayed(InStep):
    """A line that brings what the host sends so many samples later."""

    def __init__(self, box: InStep, samples: int) -> None:
        super().__init__(box.machine, box.link, box.memory)
        self.under_way: deque[bytearray] = deque(bytearray() for _ in range(samples))

    def write(self, frame: bytes) -> bool:
        self.under_way[-1].extend(frame)
        return True

    def read(self, timeout: float) -> bytes:
        self.memory.down += self.under_way.popleft()
        self.under_way.append(bytearray())
        return super().read(timeout)


class Corrupt(InStep):
    """A line on which no check sum holds."""

    def read(self, timeout: float) -> bytes:
        pieces = super().read(timeout).split(b"\0")
        return b"\0".join(
            piece[:-1] + bytes((piece[-1] ^ (3 if piece[-1] != 3 else 1),)) if piece else b"" for piece in pieces
        )


def box_of(
    memory: Any,
    bench: Bench = NOMINAL,
    effects: Effects | None = None,
    precision: Precision = "double",
    **settings: Any,
) -> InStep:
    config = BoxConfig(**settings).of_bench(bench)
    own = {name: value for name, value in bench.to_mapping().items() if hasattr(TruthBench, name)}
    plant = replace(profile("nominal"), bench=TruthBench(**own), effects=effects or Effects())
    machine = Machine(plant, bench, config, precision=precision, epoch=3)
    return InStep(machine, BoxLink(memory, machine.box, LinkFaults()), memory)


def outcomes(line: InStep, *, moving: bool = True, bench: Bench = NOMINAL) -> dict[str, tuple[str, str]]:
    results = run_cases(shipped_cases(), lambda: Host(line, line.clock), bench.to_mapping(), moving=moving)
    return {result.case.id: (result.outcome, result.found) for result in results}


def passes_every_case(line: InStep, bench: Bench = NOMINAL) -> None:
    found = outcomes(line, bench=bench)
    assert {case: result for case, result in found.items() if result[0] != PASS} == {}
    assert len(found) >= 40


BOXES: dict[str, dict[str, Any]] = {
    "nominal": {},
    "paper": {"integral": "paper"},
    "single": {"precision": "single"},
    "hydraulic force": {"feedback": "hydraulic"},
}
"""Settings of boxes, each once: a run of all cases costs seconds."""


@pytest.mark.parametrize("name", BOXES)
def test_the_box_passes_every_case(memory: Any, name: str) -> None:
    passes_every_case(box_of(memory, **BOXES[name]))


@pytest.mark.parametrize("times", [0.2, pytest.param(10.0, marks=pytest.mark.study)])
def test_a_box_of_a_smaller_and_of_a_larger_bench_passes_every_case(memory: Any, times: float) -> None:
    extensive = ("piston_area", "valve_nominal_flow", "dead_volume_a", "dead_volume_b", "moving_mass",
                 "viscous_friction", "spring_stiffness")  # fmt: skip
    values = NOMINAL.to_mapping()
    bench = Bench.from_mapping(values | {name: times * values[name] for name in extensive})
    passes_every_case(box_of(memory, bench), bench)


def test_the_time_that_a_line_takes_is_not_held_against_a_box(memory: Any) -> None:
    passes_every_case(Delayed(box_of(memory), 16))


def only(line: InStep, *names: str) -> list[Result]:
    return run_cases(
        select_cases(shipped_cases(), list(names)),
        lambda: Host(line, line.clock),
        Bench.nominal().to_mapping(),
        moving=True,
    )


@pytest.mark.parametrize("force", [-300.0, 200.0, 600.0])
def test_the_shaping_is_judged_alike_from_whatever_force_the_box_fades_in(memory: Any, force: float) -> None:
    """The jumps of f_r'' at both ends of a fade go with the force that it begins at."""
    box = box_of(memory, effects=Effects(load_cell_bias=(LoadCellBias(force=force),)))
    assert [(one.outcome, one.found) for one in only(box, "compensated.shaping")] == [(PASS, "")]


def test_a_box_whose_frames_cannot_be_read_is_told_so_once(memory: Any) -> None:
    box = box_of(memory)
    with pytest.raises(
        NoFrameError, match=r"\d+ bytes came and no frame in them for \d+ s: \d+ pieces with a wrong CRC"
    ):
        only(Corrupt(box.machine, box.link, box.memory), "framing.stream", "hello.answered")


def test_what_a_box_does_not_tell_is_left_out_or_noted(memory: Any) -> None:
    box = box_of(memory)
    for name in ("force_rate_age", "velocity_age", "digest"):
        box.machine.box.settings[name] = 0
    rates, bench = only(box, "measured.rates", "hello.bench")[::-1]
    assert (rates.outcome, rates.found) == (LEFT_OUT, "DETAILS do not tell the ages of the rates")
    assert (bench.outcome, bench.found) == (PASS, "its digest is not told: only valve_current_max is compared")


def test_without_moving_nothing_arms_and_the_piston_rests(memory: Any) -> None:
    line = box_of(memory)
    before = float(line.machine.plant.chain[0]["clean"][6])
    found = outcomes(line, moving=False)
    moved = {case.id for case in shipped_cases() if case.moving}
    assert {case for case, (outcome, _) in found.items() if outcome == LEFT_OUT} == moved
    assert all(outcome == PASS for case, (outcome, _) in found.items() if case not in moved)
    assert abs(float(line.machine.plant.chain[0]["clean"][6]) - before) < 1e-5


def test_a_case_that_arms_and_does_not_say_so_is_refused() -> None:
    with pytest.raises(UserError, match="is not marked as moving"):
        parse_cases([{"id": "x", "says": "y", "steps": [{"commands": {"samples": 1, "arm": True}}]}])


BROKEN: dict[str, tuple[str, set[str], str, str]] = {
    "takes old commands": ("guard.h", {"order.old"},
        "if (guard->heard && (ahead == 0 || ahead >= 0x80000000u)) {", "if (guard->heard && ahead == 0) {"),
    "takes repeated commands": ("guard.h", {"order.repeated", "order.no_heartbeat"},
        "if (guard->heard && (ahead == 0 || ahead >= 0x80000000u)) {", "if (guard->heard && ahead >= 0x80000000u) {"),
    "watchdog after 60 ms": ("arming.h", {"watchdog.hold", "watchdog.trip", "order.no_heartbeat"},
        "return age > config->hold_timeout;", "return age > config->hold_timeout + 0.01;"),
    "trips after 150 ms": ("arming.h", {"watchdog.trip"},
        "if (age > config->trip_timeout) {", "if (age > config->trip_timeout - 0.05) {"),
    "arms without a disarm": ("arming.h", {"arm.needs_a_disarm"},
        "arming->armed = arming->disarm_seen;\n    arming->tripped = !arming->disarm_seen;", "arming->armed = true;"),
    "does not clamp K_p": ("guard.h", {"clamp.high", "clamp.low", "refused.counted"},
        "law->delta_kp_min, law->delta_kp_max);", "HYDRO_R(-1e9), HYDRO_R(1e9));"),
    "keeps the gain where none is given": ("guard.h",
        {"clamp.not_finite", "compensated.shaping"},
        "broken ? safe : hydro_clamp", "broken ? guard->delta_kp : hydro_clamp"),
    "keeps the reference's phase back": ("reference.h", {"reference.sine"},
        "hydro_turned(angle + signal->phase)", "hydro_turned(angle)"),
    "equal weights in the multisine": ("reference.h", {"reference.multisine", "compensated.shaping"},
        "0.44789526038332517, 0.2585924491510704, 0.1692884960541141, 0.1242237944114903", "0.25, 0.25, 0.25, 0.25"),
    "edges of a quarter of a period": ("reference.h", {"reference.smooth_step", "reference.fade"},
        "#define HYDRO_EDGE 0.125", "#define HYDRO_EDGE 0.25"),
    "changes break a fade off": ("reference.h", {"reference.fade"},
        "if (time - reference->fade_start >= HYDRO_FADE && !", "if (!"),
    "a HELLO does not disarm": ("box.h", {"hello.disarms", "hello.heartbeat", "hello.safe"},
        "box->greeted = box->greeting = box->has_now = true;", "box->greeted = box->greeting = true;"),
    "the integral of the paper, called bumpless": ("force_law.h", {"law.gains"},
        "form == HYDRO_BUMPLESS", "form == 77u"),
    "the correction is lost": ("box.h", {"law.current"},
        "nominal : nominal + box->guard.delta_u;", "nominal : nominal;"),
    "late commands keep their gains": ("box.h", {"watchdog.hold", "watchdog.trip", "compensated.safe"},
        "values[HYDRO_KP] = held ? law->base_kp : ", "values[HYDRO_KP] = "),
    "accepts frames without their check sum": ("stream.h", {"framing.damaged"},
        "|| hydro_crc(data, count - 4) != hydro_read32(data + count - 4)", ""),
    "HELLO without a sequence": ("box.h", {"hello.answered"},
        "    if (box->hellos == 0) {", "    box->hellos = 0;\n    if (box->hellos == 1) {"),
    "counts samples by two": ("box.h", {"framing.stream", "framing.garbage", "line.loss", "line.load"},
        "box->sample.sequence = box->sequence++;", "box->sample.sequence = box->sequence++ * 2;"),
    "forgets FILTER_STALE": ("arming.h", {"stale.shown", "stale.armed", "hello.safe"},
        "(late || !arming->filter_fresh ? HYDRO_FILTER_STALE : 0u)", "(late ? HYDRO_FILTER_STALE : 0u)"),
    "takes frames of versions to come": ("stream.h", {"framing.foreign_version"},
        "data[0] != (hello ? 0u : HYDRO_VERSION)", "hello ? data[0] != 0 : data[0] < HYDRO_VERSION"),
    "does not tell the form of its integral": ("protocol.h", {"hello.fields"},
        "at[3] = (uint8_t)config->integral_form;", "at[3] = 0;"),
    "tells another bench": ("protocol.h", {"hello.bench"},
        "hydro_copy(at + 4, config->digest, sizeof config->digest);", 'hydro_copy(at + 4, "000000000000", 12);'),
    "a HELLO is not the begin of a conversation": ("box.h", {"hello.new_conversation"},
        "    box->guard.heard = false;\n", ""),
    "a HELLO disarms and is no heartbeat": ("box.h", {"hello.heartbeat"},
        "command->filter_fresh, time);", "command->filter_fresh, box->greeted ? box->arming.received_at : time);"),
    "sends no DETAILS": ("box.h", {"hello.details"},
        "        count += hydro_encode_details(box->hellos, time_us, box->epoch, box->config, out + count);\n", ""),
    "its clock shakes while it is disarmed": ("protocol.h", {"clock.pace"},
        "(uint64_t)(sample->time * 1e6 + 0.5)",
        "(uint64_t)(sample->time * 1e6 + ((sample->flags & 1u) == 0 && (sample->sequence & 1u) != 0 ? 300.0 : 0.5))"),
    "shows the correction while it is disarmed": ("box.h", {"idle.values", "watchdog.trip"},
        "    if (!box->arming.armed) {\n",
        "    if (!box->arming.armed) {\n        values[HYDRO_NOMINAL] = box->guard.delta_u;\n"),
    "whole integral gains only": ("box.h", {"idle.gains"},
        "law->base_ki + box->guard.delta_ki;", "law->base_ki + (hydro_real)(int)box->guard.delta_ki;"),
    "newer is a quarter of the circle": ("guard.h", {"order.wraps"}, "ahead >= 0x80000000u", "ahead >= 0x40000000u"),
    "looks at the watchdog before it takes the command": ("box.h", {"watchdog.ends", "hello.heartbeat"},
        "    hydro_box_receive(box, time);\n    late = hydro_watchdog(&box->arming, config, time);",
        "    late = hydro_watchdog(&box->arming, config, time);\n    hydro_box_receive(box, time);"),
    "refuses the range itself": ("guard.h", {"refused.range"},
        "|| signal->amplitude + offset > force_range) {", "|| signal->amplitude + offset >= force_range) {"),
    "the hydraulic force is 200 N off": ("protocol.h", {"measured.units"},
        "hydro_write32(at, sample->flags);",
        "hydro_write32(at, sample->flags);\n    hydro_write32(at - 56, hydro_bits(sample->values[0] + HYDRO_R(200)));"),
    "tells twice the age of its rates": ("protocol.h", {"measured.rates"},
        "HYDRO_R(config->trip_timeout), config->force_rate_age,",
        "HYDRO_R(config->trip_timeout), 2 * config->force_rate_age,"),
    "FILTER_STALE as long as it is armed": ("arming.h", {"arm.arms"},
        "(late || !arming->filter_fresh ? HYDRO_FILTER_STALE : 0u)",
        "(late || arming->armed || !arming->filter_fresh ? HYDRO_FILTER_STALE : 0u)"),
    "disarms a sample late": ("box.h", {"arm.off"},
        "    if (!box->arming.armed) {", "    if (!box->arming.armed && (box->sample.flags & HYDRO_ARMED) == 0) {"),
    "a refused reference becomes a hold": ("guard.h", {"reference.refused"},
        "        guard->refused[1]++;\n", "        guard->refused[1]++;\n        wanted->waveform = HYDRO_HOLD;\n"),
    "a correction stops the integral": ("box.h", {"law.nominal"},
        "values[HYDRO_KI], unlimited - current);", "values[HYDRO_KI], nominal - current);"),
    "LAW tells a safe C_1 beyond its limits": ("protocol.h",
        {"compensated.told", "compensated.safe", "compensated.shaping"},
        "law->safe[4], law->low[4],", "law->high[4] + 1, law->low[4],"),
    "coefficients jump": ("force_law.h", {"compensated.shaping", "compensated.safe"},
        "hydro_clamp(wanted[i] - state->shaping[i], -step, step)", "wanted[i] - state->shaping[i]"),
    "f_r'' moves a_2's part of f_c' where f_c has not followed it yet": ("force_law.h",
        {"compensated.shaping", "compensated.safe"},
        " + change / period * terms[i];", " + change / period * (i == 2 ? wave->second : terms[i]);"),
    "f_c jumps with f_r''": ("force_law.h", {"compensated.shaping", "compensated.safe"},
        "(HYDRO_KINK + HYDRO_PERIOD)", "HYDRO_PERIOD"),
    "coefficients stay where commands are late": ("box.h", {"compensated.safe"},
        "held ? law->safe : box->guard.shaping", "box->guard.shaping"),
    "C_2 is left out": ("force_law.h", {"compensated.nominal"},
        "hydro_real gain = scales[1] * ", "hydro_real gain = "),
}  # fmt: skip
"""What is broken: file, the cases that must fail and no others, text, and what stands there instead."""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("broken") / "firmware"
    shutil.copytree(FIRMWARE, folder)
    return folder


@pytest.fixture
def broken(copy: Path, memory: Any, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], InStep]:
    """Build a box that is broken as `BROKEN` says."""

    def build(name: str) -> InStep:
        file, _, text, instead = BROKEN[name]
        path, library = copy / "hydro" / file, copy / f"{list(BROKEN).index(name)}.so"
        whole = path.read_text()
        assert whole.count(text) == 1 or name.startswith("the integral"), "what is to be broken has changed"
        path.write_text(whole.replace(text, instead))
        try:
            compiled(copy / "hydro_box.c", library, "-O2", "-w", "-fPIC", "-shared")
        finally:
            path.write_text(whole)
        monkeypatch.setattr(firmware, "library_path", lambda precision: library)
        for kept in ("library", "function_addresses"):
            monkeypatch.setattr(firmware, kept, cache(getattr(firmware, kept).__wrapped__))
        return box_of(memory)

    return build


TRIED = [*(pytest.param(one, False, marks=pytest.mark.slow) for one in list(BROKEN)[::5]),
         *(pytest.param(one, True, marks=pytest.mark.study) for one in BROKEN)]  # fmt: skip


@pytest.mark.parametrize(("name", "all_cases"), TRIED)
def test_a_broken_box_fails_where_it_is_broken(broken: Callable[[str], InStep], name: str, all_cases: bool) -> None:
    found = only(broken(name), *(() if all_cases else BROKEN[name][1]))
    assert {result.case.id for result in found if result.outcome == FAIL} == BROKEN[name][1], found


class Unconnected(Machine):
    """A bench whose valve does not follow its current."""

    current = 0.0
    """A, that it follows."""

    def tick(self) -> np.void:
        sample = self.box.tick(self.plant.measurement(), self.time)
        truth.advance_sample(*self.plant.records, self.plant.work, self.plant.noise.row(), self.current)
        self.samples += 1
        return sample


@pytest.mark.study
def test_a_box_whose_valve_is_not_connected_passes_all_but_the_sign(memory: Any) -> None:
    """It shows the current that it should: only the force tells, and that may stand by an overlap as well."""
    machine = Unconnected(profile("nominal"))
    found = outcomes(InStep(machine, BoxLink(memory, machine.box, LinkFaults()), memory))
    assert FAIL not in {outcome for outcome, _ in found.values()}
    assert found["law.sign"][0] == NOT_JUDGED and "not connected" in found["law.sign"][1]


def test_a_bench_that_drifts_to_its_stop_passes_no_case_that_it_did_not_play(memory: Any) -> None:
    machine = Unconnected(profile("nominal"))
    machine.current = 2e-3
    found = only(InStep(machine, BoxLink(memory, machine.box, LinkFaults()), memory), "law.sign", "reference.sine")
    assert [result.outcome for result in found] == [FAIL, FAIL]
    assert all("it tripped at" in result.found and "limit of 700 N" in result.found for result in found)


def test_each_case_fails_on_a_box_that_is_broken_there() -> None:
    seen = {"law.sign"}.union(*(wanted for _, wanted, *_ in BROKEN.values()))
    assert seen == {case.id for case in shipped_cases()}
