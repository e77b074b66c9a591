# SPDX-License-Identifier: Apache-2.0
"""Strangers and second nodes beside an armed plant: nothing of theirs reaches the valve, and each is told."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros import STATE
from hydro_bridge.signals import Flag
from tests.attacks import ATTACKS, STAYS_ARMED, Defended, defended, listener
from tests.second_nodes import beside

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
        assert outcome.safe_after is None, "it was refused, and the holder goes on"
    else:
        assert outcome.safe_after is not None and outcome.safe_after < SOON
    assert outcome.error < outcome.before + 60.0, "the force went where its holder wanted it"
    assert not outcome.foreign, "gains of a stranger's"
    assert outcome.current < 2e-3, "no correction of a stranger's, of 50 mA"


def test_tools_that_join_and_listen_leave_an_armed_plant_alone(graph: Defended) -> None:
    graph.arm()
    graph.probe.forget()
    for number in range(4):
        with listener("LOCALHOST" if number % 2 else "SUBNET") as tool:
            graph.drive(20.0, until=lambda tool=tool: tool.poll() is not None)  # type: ignore[misc]
            assert tool.poll() == 0, "it heard the plant"
    states = [state for _, state in graph.probe.heard[STATE]]
    late = sum(bool(state.flags & Flag.WATCHDOG) for state in states)
    print(f"{late} of {len(states)} samples without commands for 50 ms")
    assert all(state.flags & Flag.ARMED for state in states)


@pytest.mark.parametrize("tools", [False, pytest.param(True, marks=pytest.mark.study)])
def test_second_nodes_are_told_and_leave_the_first_alone_and_a_second_plant_disarms_it(
    graph: Defended, tmp_path: Path, tools: bool
) -> None:
    found = beside(graph, tmp_path, tools=tools)
    assert found.held, found
