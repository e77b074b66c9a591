# SPDX-License-Identifier: Apache-2.0
"""Waiting for what must be there before a plant is armed: in order, told, and never for ever."""

from __future__ import annotations

import pytest

from hydro_bridge.safety.readiness import NotReadyError, Readiness, Requirement


class Scene:
    """Things that come and go, and what is said about them."""

    def __init__(self, *, filter_essential: bool = False) -> None:
        self.there: set[str] = set()
        self.said: list[str] = []
        self.readiness = Readiness(
            [
                self._needs("the plant", 100.0, True),
                self._needs("the filter", 20.0, filter_essential),
                self._needs("the learner", 50.0, True),
            ],
            self.said.append,
        )

    def _needs(self, name: str, within: float, essential: bool) -> Requirement:
        return Requirement(
            name=name,
            ready=lambda: name in self.there,
            hint=f"{name} takes its time",
            within=within,
            missing=f"{name} never came",
            essential=essential,
        )

    def look(self, start: float, end: float) -> None:
        for tick in range(round(4 * start), round(4 * end)):
            self.readiness.look(tick / 4)


def test_what_is_essential_ends_the_wait_in_its_sentence_and_what_is_not_is_done_without() -> None:
    scene = Scene()
    scene.there = {"the plant", "the learner"}
    scene.look(0.0, 30.0)
    assert scene.readiness.complete and scene.said[1:] == ["the filter never came"]
    essential = Scene(filter_essential=True)
    essential.there = {"the plant", "the learner"}
    with pytest.raises(NotReadyError, match="the filter never came"):
        essential.look(0.0, 30.0)
    assert not essential.readiness.complete


def test_time_runs_only_for_what_nothing_before_it_is_missing_for() -> None:
    scene = Scene()
    scene.look(0.0, 90.0)
    assert scene.readiness.awaited == "the plant, the filter and the learner"
    scene.there = {"the plant", "the filter"}
    scene.look(90.0, 130.0)  # 40 s of the learner's 50
    with pytest.raises(NotReadyError, match="the learner never came"):
        scene.look(130.0, 150.0)


def test_what_goes_away_is_waited_for_anew_and_what_flickers_hides_nothing_behind_it() -> None:
    scene = Scene()
    scene.there = {"the plant", "the learner"}
    scene.look(0.0, 30.0)
    scene.there.add("the filter")
    scene.look(30.0, 31.0)
    scene.there.remove("the filter")
    scene.look(31.0, 50.0)
    assert not scene.readiness.complete, "20 s anew, not given up for good"
    scene.look(50.0, 52.0)
    assert scene.readiness.complete and scene.said.count("the filter never came") == 2
    flickering = Scene()
    flickering.there = {"the plant"}
    with pytest.raises(NotReadyError, match="the learner never came"):
        for second in range(200):
            flickering.there ^= {"the filter"}
            flickering.readiness.look(float(second))
