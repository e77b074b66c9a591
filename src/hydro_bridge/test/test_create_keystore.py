# SPDX-License-Identifier: Apache-2.0
"""Keys for the graph: who may do what by the policy, the keystore that sros2 makes of it, how a node takes its keys."""

from __future__ import annotations

import os
import shutil
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytest.importorskip("rclpy")

from hydro_bridge.nodes import create_keystore
from hydro_bridge.nodes.create_keystore import domain, make_keystore, policy_xml
from hydro_bridge.ros.companion import Companion, executable_path
from hydro_bridge.ros.keys import ENABLE, KEYSTORE, STRATEGY, enclave_of, security_enabled
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
from hydro_core.errors import UserError
from hydro_core.settings import SettingsError
from tests.checks import ran, status_of

ENCLAVES = [enclave_of(executable) for executable in RIGHTS]


def allowed(kind: str, what: str, name: str) -> set[str]:
    """The executables whose policy allows `what` (publish, subscribe, reply, request) with a topic or service."""
    return {
        enclave.attrib["path"].removeprefix("/hydro/")
        for enclave in ElementTree.fromstring(policy_xml()).iter("enclave")
        for group in enclave.iter(f"{kind}s")
        if group.get(what) == "ALLOW" and name in [entry.text for entry in group]
    }


def test_only_who_has_to_may_command_the_plant() -> None:
    drivers = {"trainer", "evaluate", "collect"}
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


@pytest.mark.skipif(find_spec("sros2") is not None, reason="sros2 is here")
def test_without_sros2_one_sentence_says_the_way_on_and_the_policy_is_written_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of(create_keystore.main, tmp_path / "keys", "--policy", tmp_path / "policy.xml") == 2
    assert "apt install ros-jazzy-sros2" in capsys.readouterr().err
    assert (tmp_path / "policy.xml").read_bytes() == policy_xml()
    assert not (tmp_path / "keys").exists()


@pytest.mark.skipif(find_spec("sros2") is None or shutil.which("openssl") is None, reason="no sros2 or openssl here")
def test_a_keystore_holds_signed_permissions_for_its_owner_alone_and_an_older_one_is_left_alone(tmp_path: Path) -> None:
    keystore = tmp_path / "keys"
    make_keystore(keystore, policy_xml(), ENCLAVES)
    folders = {enclave: keystore / "enclaves" / enclave.lstrip("/") for enclave in ENCLAVES}
    for enclave, folder in folders.items():
        verify = ("openssl", "smime", "-verify", "-text", "-in", folder / "permissions.p7s", "-CAfile")
        signed = ran(*verify, folder / "permissions_ca.cert.pem", check=True).stdout
        grant = ElementTree.fromstring(signed).find("permissions/grant")
        assert grant.findtext("subject_name") == f"CN={enclave}"
        assert grant.findtext("default") == "DENY"
        assert {entry.text for entry in grant.iter("id")} == {str(domain())}
        published = {entry.text for entry in grant.findall("allow_rule/publish/topics/topic")}
        expected = {f"rt{name}" for rights in RIGHTS[enclave[7:]].values() for name in rights.publishes}
        assert {name for name in published if name and name.startswith("rt/")} == expected
        ran("openssl", "verify", "-CAfile", folder / "identity_ca.cert.pem", folder / "cert.pem", check=True)
    entries = [path for path in (tmp_path / "keys", *(tmp_path / "keys").rglob("*")) if not path.is_symlink()]
    assert all(path.stat().st_mode & 0o077 == 0 for path in entries)
    with pytest.raises(UserError, match="is there already"):
        make_keystore(keystore, policy_xml(), ENCLAVES)


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
