# SPDX-License-Identifier: Apache-2.0
"""Keys for the graph: who may do what by the policy, how a node takes its keys."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros import security_policy, topics
from hydro_bridge.ros.companion import Companion, executable_path
from hydro_bridge.ros.keys import ENABLE_VARIABLE, KEYSTORE_VARIABLE, STRATEGY_VARIABLE, enclave_name, security_enabled
from hydro_core.settings import SettingsError
from tests.checks import ran, status_of


def test_only_who_has_to_may_command_the_plant_by_the_policy_that_is_written_for_ros2_security(tmp_path: Path) -> None:
    assert status_of(security_policy.main, tmp_path / "policy.xml") == 0
    enclaves = {entry.attrib["path"]: entry for entry in ElementTree.parse(tmp_path / "policy.xml").iter("enclave")}
    assert set(enclaves) == {enclave_name(name) for name in topics.ACCESS_RIGHTS}

    def allowed(what: str, name: str) -> set[str]:
        """The executables that may do `what` (publish, subscribe, request) with a topic or service."""
        kind = "services" if what == "request" else "topics"
        return {
            path.removeprefix("/hydro/")
            for path, enclave in enclaves.items()
            for group in enclave.iter(kind)
            if group.get(what) == "ALLOW" and name in [entry.text for entry in group]
        }

    drivers = {"trainer", "evaluate", "commission", "collect"}
    assert allowed("publish", topics.GAINS) == allowed("publish", topics.REFERENCE) == drivers
    assert allowed("publish", topics.CORRECTION) == {"filter", "filtered_plant"}
    assert allowed("publish", topics.STATE) == {"bridge", "sim", "filtered_plant", "replayer"}
    assert allowed("publish", topics.AUTHORITY) == {"bridge", "sim", "filtered_plant"}
    assert "filtered_plant" not in allowed("subscribe", topics.CORRECTION), "its own alone"
    assert not allowed("request", topics.ARM_SERVICE), "who has a key disarms by name"
    assert allowed("request", topics.CLAIM_SERVICE) == drivers | {"arm", "dashboard"}
    assert allowed("request", topics.OVERRIDE_SERVICE) == {"override", "dashboard"}
    assert allowed("request", topics.END_SERVICE) == {"dashboard"}
    assert all("watch" in allowed("subscribe", topic) for topic in topics.RECORDED_TOPICS)
    assert [topic for topic in topics.RECORDED_TOPICS if "watch" in allowed("publish", topic)] == [topics.LOG], (
        "its own log"
    )


def test_where_security_is_on_a_missing_key_stops_a_node_unless_the_user_says_otherwise_in_ros_s_words(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(STRATEGY_VARIABLE, "")  # set, so that it is put back
    monkeypatch.delenv(STRATEGY_VARIABLE)
    monkeypatch.setenv(ENABLE_VARIABLE, "false")
    assert not security_enabled() and STRATEGY_VARIABLE not in os.environ
    monkeypatch.setenv(ENABLE_VARIABLE, "true")
    assert security_enabled() and os.environ[STRATEGY_VARIABLE] == "Enforce"
    monkeypatch.setenv(STRATEGY_VARIABLE, "Permissive")
    assert security_enabled() and os.environ[STRATEGY_VARIABLE] == "Permissive"
    for variable, value in (
        (STRATEGY_VARIABLE, "enforce"),
        (ENABLE_VARIABLE, "1"),
        (ENABLE_VARIABLE, "True"),
    ):  # ROS takes these for off
        with monkeypatch.context() as wrong, pytest.raises(SettingsError, match=f"{variable}={value}"):
            wrong.setenv(variable, value)
            security_enabled()


@pytest.mark.graph
def test_a_node_that_cannot_use_its_keys_ends_with_a_sentence(tmp_path: Path) -> None:
    keystore = tmp_path / "keys"
    (keystore / "enclaves" / "hydro" / "arm").mkdir(parents=True)  # without keys
    environment = os.environ | {ENABLE_VARIABLE: "true", KEYSTORE_VARIABLE: str(keystore)}
    answer = ran(executable_path("hydro_bridge", "arm"), env=environment, timeout=60)
    assert answer.returncode == 2 and "Traceback" not in answer.stderr
    assert f"error: ROS does not start with keys ({KEYSTORE_VARIABLE}: {keystore})" in answer.stderr


def test_what_is_started_beside_a_node_does_not_inherit_the_enclave_that_its_user_chose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_SECURITY_ENCLAVE_OVERRIDE", "/hydro/watch")
    monkeypatch.setenv("HYDRO_INHERITED", "yes")
    with Companion("hydro_bridge", "bridge", ["--port", "/nowhere/port"]) as companion:
        environment = Path(f"/proc/{companion.process.pid}/environ").read_bytes()
    assert b"HYDRO_INHERITED=yes" in environment and b"ENCLAVE_OVERRIDE" not in environment
