# SPDX-License-Identifier: Apache-2.0
"""Where no plant is named: the one that runs, or the simulation if a person wants it."""

from __future__ import annotations

from typing import cast

import pytest

pytest.importorskip("rclpy")

from rclpy.node import Node

from hydro_bridge.errors import UserError
from hydro_policy.nodes.startup import options as module
from hydro_policy.nodes.startup.options import choose_plant


class Looking:
    """Sees a publisher of states from the given look on; None: never."""

    def __init__(self, first: int | None) -> None:
        self.first, self.looks = first, 0

    def count_publishers(self, topic: str) -> int:
        self.looks += 1
        return int(self.first is not None and self.looks > self.first)


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LOOK", 0.2)
    monkeypatch.setattr(module, "WAIT", 0.2)


@pytest.mark.parametrize("first", [0, 2])
def test_a_plant_that_runs_is_taken_and_nobody_is_asked(first: int) -> None:
    def ask(question: str) -> str:
        raise AssertionError(question)

    assert choose_plant(cast(Node, Looking(first)), ask) == "external"


@pytest.mark.parametrize("answer", ["", "y", "Yes "])
def test_the_simulation_is_started_if_a_person_wants_it(answer: str) -> None:
    asked: list[str] = []
    assert choose_plant(cast(Node, Looking(None)), lambda question: (asked.append(question), answer)[1]) == "sim"
    assert len(asked) == 1 and "Start the simulation" in asked[0]


def test_who_declines_is_told_what_can_be_named() -> None:
    with pytest.raises(UserError, match=r"no plant runs: .* --plant sim, emulator or bench"):
        choose_plant(cast(Node, Looking(None)), lambda question: "n")
