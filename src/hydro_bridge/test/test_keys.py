# SPDX-License-Identifier: Apache-2.0
"""Keys for the graph: who may do what by the policy, how a node takes its keys."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros import policy
from hydro_bridge.ros.companion import Companion, executable_path
from hydro_bridge.ros.keys import ENABLE, KEYSTORE, STRATEGY, enclave_name, security_enabled
from hydro_bridge.ros.policy import policy_xml
from hydro_bridge.ros.topics import (
    ARM_SERVICE,
    AUTHORITY,
    CLAIM_SERVICE,
    CORRECTION,
    END_SERVICE,
    GAINS,
    GRAPH,
    LOG,
    OVERRIDE_SERVICE,
    REFERENCE,
    RIGHTS,
    STATE,
)
from hydro_core.settings import SettingsError
from tests.checks import ran, status_of


def allowed(kind: str, what: str, name: str) -> set[str]:
    """The executables whose policy allows `what` (publish, subscribe, reply, request) with a topic or service."""
    return {
        enclave.attrib["path"].removeprefix("/hydro/")
        for enclave in ElementTree.fromstring(policy_xml()).iter("enclave")
        for group in enclave.iter(f"{kind}s")
        if group.get(what) == "ALLOW" and name in [entry.text for entry in group]
    }


def test_only_who_has_to_may_command_the_plant() -> None:
    drivers = {"trainer", "evaluate", "commission", "collect"}
    assert allowed("topic", "publish", GAINS) == drivers
    assert allowed("topic", "publish", REFERENCE) == drivers
    assert allowed("topic", "publish", CORRECTION) == {"filter", "filtered_plant"}
    assert allowed("topic", "publish", STATE) == {"bridge", "sim", "filtered_plant", "replayer"}
    assert allowed("topic", "publish", AUTHORITY) == {"bridge", "sim", "filtered_plant"}
    assert "filtered_plant" not in allowed("topic", "subscribe", CORRECTION), "its own alone"
    assert not allowed("service", "request", ARM_SERVICE), "who has a key disarms by name"
    assert allowed("service", "request", CLAIM_SERVICE) == drivers | {"arm", "dashboard"}
    assert allowed("service", "request", OVERRIDE_SERVICE) == {"override", "dashboard"}
    assert allowed("service", "request", END_SERVICE) == {"dashboard"}
    assert all("watch" in allowed("topic", "subscribe", topic) for topic in GRAPH)
    assert [topic for topic in GRAPH if "watch" in allowed("topic", "publish", topic)] == [LOG], "its own log"


def test_the_policy_is_written_for_ros2_security(tmp_path: Path) -> None:
    assert status_of(policy.main, tmp_path / "policy.xml") == 0
    assert (tmp_path / "policy.xml").read_bytes() == policy_xml()
    root = ElementTree.fromstring(policy_xml())
    assert {entry.attrib["path"] for entry in root.iter("enclave")} == {enclave_name(name) for name in RIGHTS}


def test_where_security_is_on_a_missing_key_stops_a_node_unless_the_user_says_otherwise_in_ros_s_words(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(STRATEGY, "")  # set, so that it is put back
    monkeypatch.delenv(STRATEGY)
    monkeypatch.setenv(ENABLE, "false")
    assert not security_enabled() and STRATEGY not in os.environ
    monkeypatch.setenv(ENABLE, "true")
    assert security_enabled() and os.environ[STRATEGY] == "Enforce"
    monkeypatch.setenv(STRATEGY, "Permissive")
    assert security_enabled() and os.environ[STRATEGY] == "Permissive"
    for variable, value in ((STRATEGY, "enforce"), (ENABLE, "1"), (ENABLE, "True")):  # ROS takes these for off
        with monkeypatch.context() as wrong, pytest.raises(SettingsError, match=f"{variable}={value}"):
            wrong.setenv(variable, value)
            security_enabled()


@pytest.mark.graph
def test_a_node_that_cannot_use_its_keys_ends_with_a_sentence(tmp_path: Path) -> None:
    keystore = tmp_path / "keys"
    (keystore / "enclaves" / "hydro" / "arm").mkdir(parents=True)  # without keys
    environment = os.environ | {ENABLE: "true", KEYSTORE: str(keystore)}
    answer = ran(executable_path("hydro_bridge", "arm"), env=environment, timeout=60)
    assert answer.returncode == 2 and "Traceback" not in answer.stderr
    assert f"error: ROS does not start with keys ({KEYSTORE}: {keystore})" in answer.stderr


def test_what_is_started_beside_a_node_does_not_inherit_the_enclave_that_its_user_chose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_SECURITY_ENCLAVE_OVERRIDE", "/hydro/watch")
    monkeypatch.setenv("HYDRO_INHERITED", "yes")
    with Companion("hydro_bridge", "bridge", ["--port", "/nowhere/port"]) as companion:
        environment = Path(f"/proc/{companion.process.pid}/environ").read_bytes()
    assert b"HYDRO_INHERITED=yes" in environment
    assert b"ENCLAVE_OVERRIDE" not in environment
