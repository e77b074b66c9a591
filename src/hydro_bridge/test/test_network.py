# SPDX-License-Identifier: Apache-2.0
"""A node of ours reaches no further than this machine unless the user says so, however it was started."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros.companion import Companion
from hydro_bridge.ros.node import DISCOVERY_RANGE_VARIABLE, FASTDDS_PROFILES_VARIABLE, running_ros
from hydro_core.settings import SettingsError
from tests.checks import wait

# not beside strangers that reach the network (test_graph_authority.py): memberships are the machine's
pytestmark = [pytest.mark.graph, pytest.mark.xdist_group("graph")]


def sockets(pid: int) -> set[tuple[str, int]]:
    """(address, port) of each internet socket that the process has."""
    found = [one for one in psutil.net_connections("inet") if one.pid == pid]
    assert {one.family for one in found} <= {socket.AF_INET}, "nothing of ours speaks IPv6"
    return {(one.laddr.ip, one.laddr.port) for one in found if one.laddr}


def memberships() -> int:
    """How often this machine has joined the multicast group of ROS's discovery, 239.255.0.1."""
    return Path("/proc/net/igmp").read_text().count("0100FFEF")


def test_a_node_listens_on_the_loopback_interface_only_unless_the_user_says_otherwise(
    start: Callable[..., Companion], monkeypatch: pytest.MonkeyPatch
) -> None:
    def bridge() -> Companion:
        """A bridge without a port, once it has sockets."""
        node = start("hydro_bridge bridge", "--port", "/nowhere/port")
        wait(lambda: len(sockets(node.process.pid)) >= 4, 30.0)
        time.sleep(1.0)
        mapped = Path(f"/proc/{node.process.pid}/maps").read_text()
        assert "/dev/shm/fastrtps" not in mapped, "Fast DDS' shared memory, where its writers wait for newcomers"
        return node

    for variable in (DISCOVERY_RANGE_VARIABLE, FASTDDS_PROFILES_VARIABLE):
        monkeypatch.delenv(variable, raising=False)
    before, node = memberships(), bridge()
    found = sockets(node.process.pid)
    assert memberships() == before
    assert {address for address, _ in found} == {"127.0.0.1"}
    assert any(7400 <= port < 7400 + 250 * 102 for _, port in found), "the ports of ROS's discovery"
    node.stop()
    monkeypatch.setenv(DISCOVERY_RANGE_VARIABLE, "SUBNET")
    found = sockets(bridge().process.pid)
    assert any(address == "0.0.0.0" and 7400 <= port < 32768 for address, port in found) and memberships() > 0


@pytest.mark.parametrize("domain", ["233", "-1", "abc", "1.5"])
def test_a_domain_that_dds_has_no_ports_for_is_refused(domain: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    told = f"ROS_DOMAIN_ID={domain}: must be a whole number from 0 to 232"
    with pytest.raises(SettingsError, match=told), running_ros():
        pass
