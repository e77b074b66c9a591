# SPDX-License-Identifier: Apache-2.0
"""Strangers and second nodes beside an armed plant: nothing of theirs reaches the valve, and each is told."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros import CORRECTION, STATE, Companion
from hydro_bridge.signals import Flag
from tests.attacks import ATTACKS, STAYS_ARMED, Defended, defended
from tests.graph_probe import trainer

pytestmark = pytest.mark.graph

SOON = 3.5
"""s; 0.1 s and less were measured, the rest is for a busy machine and its discovery."""


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Defended]:
    with defended(Path(tmp_path_factory.mktemp("graph"))) as made:
        yield made


@pytest.mark.parametrize("name", list(ATTACKS))
def test_what_a_stranger_does_is_refused_or_the_plant_is_made_safe(graph: Defended, name: str) -> None:
    outcome = graph.attack(name, ATTACKS[name])
    print(outcome)
    if name in STAYS_ARMED:
        # The box may trip while the stranger joins: Fast DDS holds the plant's thread up (authority.md, "Open").
        assert outcome.safe_after is None or outcome.tripped, "it was refused, and the holder goes on"
    else:
        assert outcome.safe_after is not None and outcome.safe_after < SOON
    assert outcome.error < outcome.before + 60.0, "the force went where its holder wanted it"
    assert not outcome.foreign, "gains of a stranger's"
    assert outcome.current < 2e-3, "no correction of a stranger's, of 50 mA"


def test_a_second_filter_recorder_and_trainer_are_told_and_leave_the_first_alone(
    graph: Defended, tmp_path: Path
) -> None:
    graph.arm()
    probe, said = graph.probe, io.StringIO()
    words = ("--plant", "external", "--from", "scratch", "--rearm", "auto", "--runs", str(tmp_path), "--name", "run")
    second = Companion("hydro_filter", "filter", [], output=said)
    recorder = Companion("hydro_bridge", "recorder", ["--out", str(tmp_path / "bag")])
    try:
        with trainer(*words) as process:
            probe.forget()
            for _ in range(90):
                graph.drive(1.0)
                if "probe commands this plant: end it" in process.text and "answers already" in said.getvalue():
                    break
            else:
                pytest.fail("they were not told")
            graph.drive(3.0)
            assert probe.node.count_publishers(CORRECTION) == 1
            assert all(state.flags & Flag.ARMED for _, state in probe.heard[STATE]), "the first one goes on"
            assert process.process.poll() is None, "it waits for its turn"
    finally:
        second.stop()
        recorder.stop()


def test_a_second_plant_disarms_the_first_which_says_so(graph: Defended) -> None:
    graph.arm()
    begun = len(graph.text)

    def told() -> bool:
        lines = graph.text[begun:]  # an attack before has brought the same words
        return any("2 nodes publish /hydro/state" in line and "disarmed until" in line for line in lines)

    second = Companion("hydro_sim", "sim", ["--model", "analytic"], output=io.StringIO())
    try:
        for _ in range(60):
            graph.drive(0.5)
            if told():
                break
        assert told()
    finally:
        second.stop()
