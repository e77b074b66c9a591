# SPDX-License-Identifier: Apache-2.0
"""Each executable does on the graph what the table of rights says, no more and no less: keys made of it fit what runs.

No keys are needed for it: names of enclaves travel without, and endpoints are the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

import rclpy
from rclpy.node import Node

from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.ros.companion import Companion
from hydro_bridge.ros.keys import enclave_name
from hydro_bridge.ros.topics import ACCESS_RIGHTS, FREEZE_SERVICE, LAW, LAW_STATE
from hydro_core.signals import STATE_DTYPE

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("domain")]

QUERIES = {
    "publishes": Node.get_publisher_names_and_types_by_node,
    "subscribes": Node.get_subscriber_names_and_types_by_node,
    "answers": Node.get_service_names_and_types_by_node,
    "calls": Node.get_client_names_and_types_by_node,
}
SETTLED = 2.0  # s that nothing may be added in, once all is there that is expected
SHORT = ("--ros-args", "-p", "task.steps_per_episode:=300", "-p", "exam.every:=0")
Does = dict[str, dict[str, dict[str, set[str]]]]  # by enclave, node and kind
CLOSING = {LAW, LAW_STATE, FREEZE_SERVICE}  # what a trainer does in its closing comparison only


def check(*executables: str, without: Mapping[str, set[str]] | None = None, timeout: float = 120.0) -> None:
    """They do what the table says; `without` names what, or which node, one has under other circumstances only.

    What each node of each enclave was ever seen to do counts, until all that is expected was, and a little longer.
    """
    expected, seen = Does(), Does()
    for executable in executables:
        left_out = (without or {}).get(executable, set())
        expected[enclave_name(executable)] = {
            name: {kind: set(getattr(rights, kind)) - left_out for kind in QUERIES}
            for name, rights in ACCESS_RIGHTS[executable].items()
            if name not in left_out
        }
    context = rclpy.Context()
    rclpy.init(context=context)
    looker = rclpy.create_node("looker", context=context)
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if seen == expected:
            end = min(end, time.monotonic() + SETTLED)
        time.sleep(0.2)
        for name, namespace, enclave in looker.get_node_names_and_namespaces_with_enclaves():
            if name == "looker" or enclave in ("", "/"):  # not known yet; no executable's
                continue
            does = seen.setdefault(enclave, {}).setdefault(name, {kind: set() for kind in QUERIES})
            for kind, ask in QUERIES.items():
                with suppress(RuntimeError):  # it has ended meanwhile, or is not known yet
                    does[kind] |= {entry for entry, _ in ask(looker, name, namespace)}
    looker.destroy_node()
    rclpy.shutdown(context=context)
    assert seen == expected


def test_a_training_on_the_emulator(start: Callable[..., Companion], tmp_path: Path) -> None:
    words = ("--plant", "emulator", "--runs", tmp_path, "--name", "run", "--episodes", "50")
    start("hydro_policy trainer", *words, *SHORT)
    check("trainer", "filtered_plant", "recorder", without={"trainer": CLOSING, "filtered_plant": {"sim"}})


def test_a_recorded_evaluation_on_the_simulation(start: Callable[..., Companion], tmp_path: Path) -> None:
    words = ("--plant", "sim", "--fixed", "90", "15", "--law", "compensated", "--runs", tmp_path)
    start("hydro_policy evaluate", *words)
    check("evaluate", "filtered_plant", "recorder", without={"filtered_plant": {"bridge"}})


def test_collecting_from_a_simulation_off_real_time(start: Callable[..., Companion], tmp_path: Path) -> None:
    hold = {"seconds": 60.0, "waveform": "hold", "offset": 300.0, "kp": 60.0}
    (tmp_path / "schedule.yaml").write_text(yaml.safe_dump({"segments": [hold]}))
    start("hydro_filter filter")
    start("hydro_sim sim", "--pace", "2")
    start("hydro_policy collect", "--out", tmp_path / "run", "--schedule", tmp_path / "schedule.yaml")
    check("sim", "filter", "collect", "recorder")


def test_a_replayer(start: Callable[..., Companion], tmp_path: Path) -> None:
    states = np.zeros(2000, STATE_DTYPE)
    states["time"], states["sequence"] = 1e-3 * np.arange(2000), np.arange(2000)
    with BagWriter(tmp_path / "run") as writer:
        writer.write_states(states)
    start("hydro_bridge replayer", tmp_path / "run", "--loop")
    check("replayer")


def test_the_live_page_and_commands_of_a_person(start: Callable[..., Companion]) -> None:
    """The commands look for somebody who answers, override for 10 s, and nobody is there."""
    start("hydro_bridge dashboard", "--port", "0")
    start("hydro_bridge arm", "--timeout", "60")
    start("hydro_policy override", "--off")
    check("dashboard", "arm", "override")
