# SPDX-License-Identifier: Apache-2.0
"""Each executable does on the graph what the table of rights says, no more and no less: keys made of it fit what runs.

No keys are needed for it: names of enclaves travel without, and endpoints are the same.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import yaml

rclpy = pytest.importorskip("rclpy")

from rclpy.node import Node  # noqa: E402

from hydro_bridge.bags.recording import BagWriter  # noqa: E402
from hydro_bridge.ros.companion import Companion  # noqa: E402
from hydro_bridge.ros.keys import enclave_of  # noqa: E402
from hydro_bridge.ros.topics import CLOCK, FREEZE_SERVICE, LAW, LAW_STATE, RIGHTS, Rights  # noqa: E402  # noqa: E402
from hydro_bridge.signals import STATE_DTYPE  # noqa: E402
from tests.graph_probe import own_domain  # noqa: E402

pytestmark = pytest.mark.graph

QUERIES = {
    "publishes": Node.get_publisher_names_and_types_by_node,
    "subscribes": Node.get_subscriber_names_and_types_by_node,
    "answers": Node.get_service_names_and_types_by_node,
    "calls": Node.get_client_names_and_types_by_node,
}
SETTLED = 2.0  # s that nothing may be added in, once all is there that is expected
SHORT = ("--ros-args", "-p", "task.steps_per_episode:=300", "-p", "exam.every:=0")


class Looker:
    """Keeps what each node of each enclave was ever seen to do."""

    def __init__(self) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("looker", context=self._context)
        self.seen: dict[str, dict[str, dict[str, set[str]]]] = {}

    def look(self) -> None:
        for name, namespace, enclave in self._node.get_node_names_and_namespaces_with_enclaves():
            if name == self._node.get_name():
                continue
            does = self.seen.setdefault(enclave, {}).setdefault(name, {kind: set() for kind in QUERIES})
            for kind, ask in QUERIES.items():
                try:
                    does[kind] |= {entry for entry, _ in ask(self._node, name, namespace)}
                except RuntimeError:  # it has ended meanwhile, or is not known yet
                    continue

    def wait(self, expected: Mapping[str, Mapping[str, Mapping[str, set[str]]]], timeout: float) -> None:
        """Look until all that is expected was seen, and a little longer."""
        end = time.monotonic() + timeout
        while self.seen != expected and time.monotonic() < end:
            time.sleep(0.2)
            self.look()
        end = time.monotonic() + SETTLED
        while time.monotonic() < end:
            time.sleep(0.2)
            self.look()

    def close(self) -> None:
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture
def looker() -> Iterator[Looker]:
    with own_domain():
        looker = Looker()
        yield looker
        looker.close()


@pytest.fixture
def running() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


CLOSING = {LAW, LAW_STATE, FREEZE_SERVICE}  # what a trainer does in its closing comparison only


def table(
    *executables: str, without: Mapping[str, set[str]] | None = None
) -> dict[str, dict[str, dict[str, set[str]]]]:
    """What the table says of some; `without` names what one of them does under other circumstances only."""
    omitted = without or {}

    def names(executable: str, rights: Rights) -> dict[str, set[str]]:
        left_out = omitted.get(executable, set())
        return {field.name: set(getattr(rights, field.name)) - left_out for field in fields(rights)}

    return {
        enclave_of(executable): {name: names(executable, rights) for name, rights in RIGHTS[executable].items()}
        for executable in executables
    }


def check(looker: Looker, expected: dict[str, dict[str, dict[str, set[str]]]], timeout: float = 60.0) -> None:
    looker.wait(expected, timeout)
    assert looker.seen == expected


def test_a_training_on_the_emulator(looker: Looker, running: ExitStack, tmp_path: Path) -> None:
    words = ["--plant", "emulator", "--runs", str(tmp_path), "--name", "run", "--episodes", "50", *SHORT]
    running.enter_context(Companion("hydro_policy", "trainer", words))
    check(
        looker, table("trainer", "bridge", "filter", "recorder", without={"filter": {CLOCK}, "trainer": CLOSING}), 120.0
    )


def test_a_recorded_evaluation_on_the_simulation(looker: Looker, running: ExitStack, tmp_path: Path) -> None:
    words = ["--plant", "sim", "--fixed", "90", "15", "--law", "compensated", "--runs", str(tmp_path)]
    running.enter_context(Companion("hydro_policy", "evaluate", words))
    clock = {"filter": {CLOCK}, "sim": {CLOCK}}
    check(looker, table("evaluate", "sim", "filter", "recorder", without=clock), 120.0)


def test_collecting_from_a_simulation_off_real_time(looker: Looker, running: ExitStack, tmp_path: Path) -> None:
    schedule = tmp_path / "schedule.yaml"
    hold = {"seconds": 60.0, "waveform": "hold", "offset": 300.0, "kp": 60.0}
    schedule.write_text(yaml.safe_dump({"segments": [hold]}))
    running.enter_context(Companion("hydro_filter", "filter"))
    running.enter_context(Companion("hydro_sim", "sim", ["--speed", "2"]))
    words = ["--out", str(tmp_path / "run"), "--schedule", str(schedule)]
    running.enter_context(Companion("hydro_sim", "collect", words))
    check(looker, table("sim", "filter", "collect", "recorder"))


def test_a_replayer(looker: Looker, running: ExitStack, tmp_path: Path) -> None:
    states = np.zeros(2000, STATE_DTYPE)
    states["time"], states["sequence"] = 1e-3 * np.arange(2000), np.arange(2000)
    with BagWriter(tmp_path / "run") as writer:
        writer.write_states(states)
    running.enter_context(Companion("hydro_bridge", "replayer", [str(tmp_path / "run"), "--loop"]))
    check(looker, table("replayer"))


def test_the_live_page_and_commands_of_a_person(looker: Looker, running: ExitStack) -> None:
    """The commands look for somebody who answers, override for 10 s, and nobody is there."""
    running.enter_context(Companion("hydro_bridge", "dashboard", ["--port", "0"]))
    running.enter_context(Companion("hydro_bridge", "arm", ["--timeout", "60"]))
    running.enter_context(Companion("hydro_policy", "override", ["--off"]))
    check(looker, table("dashboard", "arm", "override"))
