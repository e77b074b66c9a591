# SPDX-License-Identifier: Apache-2.0
"""The plant's clock: who is waited for, how far behind, and for how long."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest

from hydro_bridge.plant_clock import (
    COMMANDER_WINDOW,
    FILTER_WINDOW,
    RECORDER_WINDOW,
    LockStep,
    LockStepSettings,
    parse_pace,
)
from hydro_core.settings import SettingsError
from tests.checks import wait


class Plant:
    """A plant's thread that takes samples from 0 on; the last of `samples` waits once it is in `published`."""

    def __init__(self, **settings: object) -> None:
        self.said: list[str] = []
        self.samples: list[int] = []
        self.published: list[int] = []
        self.again: list[int] = []
        self.lock_step = LockStep(LockStepSettings(**settings), self.said.append)
        self.thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        answered = threading.Event()
        self.lock_step.on_release = answered.set
        self.lock_step.wait_for_peers()
        while not self.lock_step._closed:
            sequence = len(self.samples)
            self.samples.append(sequence)
            answered.clear()
            self.lock_step.begin_sample(sequence, lambda sequence=sequence: self.again.append(sequence))
            self.published.append(sequence)
            while not answered.is_set():
                answered.wait(self.lock_step.poll())

    def stands_at(self, sequence: int) -> bool:
        """Whether it has come to this sample, and goes no further."""
        wait(lambda: self.published and self.published[-1] >= sequence)
        time.sleep(0.05)
        return self.samples[-1] == sequence


@pytest.fixture
def plant() -> Iterator[Callable[..., Plant]]:
    """Start a plant that waits for `absent` and for the peers that are ready, by the window of each."""
    made: list[Plant] = []

    def make(absent: str = "", *, silence_max: float = 60.0, meet_max: float = 300.0, **ready: int) -> Plant:
        made.append(it := Plant(peers=" ".join((absent, *ready)), silence_max=silence_max, meet_max=meet_max))
        for name, window in ready.items():
            it.lock_step.on_answer(name, None, window)
        it.thread.start()
        return it

    yield make
    for one in made:
        one.lock_step.close()
        one.thread.join(30.0)
        assert not one.thread.is_alive()


@pytest.mark.parametrize("window", [FILTER_WINDOW, COMMANDER_WINDOW, RECORDER_WINDOW])
def test_the_plant_is_never_a_window_ahead_of_a_peer_and_a_new_one_gets_the_sample_at_which_it_stands(plant, window):
    it = plant(one=window)
    assert it.stands_at(0), "the first sample is answered by everybody"
    it.lock_step.on_answer("one", 0, window)
    assert it.stands_at(window) and window not in it.again
    it.lock_step.on_answer("another", None, RECORDER_WINDOW)
    wait(lambda: window in it.again)


@pytest.mark.parametrize("after", [27118, 25612, 3])
def test_after_samples_that_are_missing_a_commander_is_waited_for_from_the_next_step_on(after: int) -> None:
    """As a line that was unplugged, or has lost the end of a step, or a box that was switched on again leaves them."""
    lock_step = LockStep(LockStepSettings(), lambda _: None)
    lock_step.on_answer("one", None, COMMANDER_WINDOW)
    for sequence in (25600, 25601, after, after + 1):
        lock_step.begin_sample(sequence, lambda: None)
        assert lock_step.pending is (sequence == 25600)
        lock_step.on_answer("one", 25600, COMMANDER_WINDOW)
    lock_step.begin_sample(after // 10 * 10 + 10, lambda: None)
    assert lock_step.pending


def test_the_first_sample_waits_until_all_that_are_to_be_met_are_ready_but_not_for_ever(plant) -> None:
    it = plant("trainer", filter=FILTER_WINDOW)
    time.sleep(0.05)
    assert not it.samples
    it.lock_step.on_answer("trainer", None, COMMANDER_WINDOW)
    assert it.stands_at(0)
    it = plant("filter", meet_max=0.3)
    wait(lambda: it.samples)
    assert it.said == ["filter did not come: beginning without"]


def test_an_answer_counts_once_the_commands_that_it_names_have_arrived(plant) -> None:
    it = plant(trainer=COMMANDER_WINDOW)
    assert it.stands_at(0)
    it.lock_step.on_answer("trainer", 0, COMMANDER_WINDOW, commands=2)
    it.lock_step.on_command()
    assert it.stands_at(0)
    it.lock_step.on_command()
    assert it.stands_at(10)
    it.lock_step.reset_commands()
    it.lock_step.on_answer("trainer", 10, COMMANDER_WINDOW, commands=1)
    assert it.stands_at(10), "another holder counts from nothing"
    it.lock_step.on_command()
    assert it.stands_at(20)


def test_a_silent_peer_is_told_and_left_behind_and_one_that_works_is_not(plant) -> None:
    it = plant(silence_max=0.6, filter=FILTER_WINDOW, trainer=COMMANDER_WINDOW)
    for _ in range(8):
        it.lock_step.on_answer("filter", None, FILTER_WINDOW)  # still at it
        time.sleep(0.1)
    assert it.stands_at(0)
    wait(lambda: len(it.samples) > 5)
    assert "filter gave no answer to sample 0 for 0.6 s and counts as dead: the plant goes on without it" in it.said
    assert 0 in it.again, "the first sample was sent again: it may have been missed"


def test_a_peer_that_is_gone_from_the_graph_is_not_waited_for(plant) -> None:
    it = plant(filter=FILTER_WINDOW, trainer=COMMANDER_WINDOW)
    assert it.stands_at(0)
    it.lock_step.retain_peers({"filter"})
    assert it.stands_at(0)
    it.lock_step.retain_peers({"recorder"})
    wait(lambda: len(it.samples) > 5)


def test_without_a_commander_it_goes_no_faster_than_real_time(plant) -> None:
    begin, it = time.monotonic(), plant()
    wait(lambda: len(it.samples) > 300)
    assert time.monotonic() - begin > 0.28
    it.lock_step.on_answer("trainer", None, COMMANDER_WINDOW)
    wait(lambda: it.samples[-1] % 10 == 0 and it.stands_at(it.samples[-1]), 10.0)


def test_until_an_arming_is_confirmed_nobody_is_waited_for(plant) -> None:
    it = plant(trainer=COMMANDER_WINDOW)
    assert it.stands_at(0)
    assert it.lock_step.run_until(lambda: it.samples[-1] >= 3)
    assert it.stands_at(3), "what comes after waits again: for the answer to the step of the first sample"
    assert not it.lock_step.run_until(lambda: False)
    assert 500 <= it.samples[-1] <= 510, "half a second of the plant's"


def test_a_pace_is_the_plants_or_real_time_or_a_factor_of_it() -> None:
    assert [parse_pace(text) for text in ("plant", "real", "0.5", "20")] == [None, 1.0, 0.5, 20.0]
    for text in ("", "fast", "0", "-1", "nan", "inf", "1000"):
        with pytest.raises(SettingsError, match="say plant, real, or a factor"):
            parse_pace(text)
