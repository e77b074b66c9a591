# SPDX-License-Identifier: Apache-2.0
"""A node of ours reaches no further than this machine unless the user says so, however it was started."""

from __future__ import annotations

import os
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros.companion import executable_path
from hydro_bridge.ros.node import DISCOVERY_RANGE, FASTDDS_PROFILES, running_ros
from hydro_core.settings import SettingsError

# not beside strangers that reach the network (test_graph_authority.py): memberships are the machine's
pytestmark = [pytest.mark.graph, pytest.mark.xdist_group("graph")]


@contextmanager
def bridge(**environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """A bridge without a port, once it has sockets; of the network it knows only what `environment` says."""
    inherited = {name: value for name, value in os.environ.items() if name not in (DISCOVERY_RANGE, FASTDDS_PROFILES)}
    process = subprocess.Popen(
        [str(executable_path("hydro_bridge", "bridge")), "--port", "/nowhere/port"],
        env=inherited | environment,
        stderr=subprocess.DEVNULL,
    )
    try:
        end = time.monotonic() + 30.0
        while len(sockets(process.pid)) < 4 and time.monotonic() < end:
            time.sleep(0.1)
        time.sleep(1.0)
        yield process
    finally:
        process.terminate()
        process.wait(10.0)


def sockets(pid: int) -> set[tuple[str, int]]:
    """(address, port) of each internet socket that the process has."""
    found = [one for one in psutil.net_connections("inet") if one.pid == pid]
    assert {one.family for one in found} <= {socket.AF_INET}, "nothing of ours speaks IPv6"
    return {(one.laddr.ip, one.laddr.port) for one in found if one.laddr}


def memberships() -> int:
    """How often this machine has joined the multicast group of ROS's discovery, 239.255.0.1."""
    return Path("/proc/net/igmp").read_text().count("0100FFEF")


def shares_memory(pid: int) -> bool:
    """Whether the process has memory of Fast DDS' own transport mapped: its writers wait for newcomers there."""
    return "/dev/shm/fastrtps" in Path(f"/proc/{pid}/maps").read_text()


def test_a_node_listens_on_the_loopback_interface_only_unless_the_user_says_otherwise() -> None:
    before = memberships()
    with bridge() as node:
        found = sockets(node.pid)
        assert memberships() == before and not shares_memory(node.pid)
        assert {address for address, _ in found} == {"127.0.0.1"}
        assert any(7400 <= port < 7400 + 250 * 102 for _, port in found), "the ports of ROS's discovery"
    with bridge(**{DISCOVERY_RANGE: "SUBNET"}) as node:
        assert any(address == "0.0.0.0" and 7400 <= port < 32768 for address, port in sockets(node.pid))
        assert memberships() > 0 and not shares_memory(node.pid)


@pytest.mark.parametrize("domain", ["233", "-1", "abc", "1.5"])
def test_a_domain_that_dds_has_no_ports_for_is_refused(domain: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with (
        pytest.raises(SettingsError, match=f"ROS_DOMAIN_ID={domain}: must be a whole number from 0 to 232"),
        running_ros(),
    ):
        pass
