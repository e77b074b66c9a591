# SPDX-License-Identifier: Apache-2.0
"""The page's server: its files, several viewers, one that does not read; what it is told, and who may do what."""

from __future__ import annotations

import asyncio
import http.client
import re
import socket
import time
from collections.abc import Iterator
from functools import partial
from importlib import resources
from itertools import product
from urllib.error import HTTPError
from urllib.request import urlopen

import msgspec
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from hydro_bridge.pages import commands
from hydro_bridge.pages import server as page
from hydro_bridge.pages.commands import PageCommand, answer_commands, authorize
from hydro_bridge.pages.server import PageServer
from hydro_core.errors import UserError
from tests.checks import wait
from tests.domains import own_domain


@pytest.fixture
def heard() -> list[PageCommand]:
    """What viewers send to the server."""
    return []


def page_server(attend=None, port: int | None = 0) -> PageServer:
    return PageServer({"/": b"page"}, attend, policy="", message_size_max=commands.COMMAND_SIZE_MAX, port=port)


@pytest.fixture
def server(heard) -> Iterator[PageServer]:
    async def execute(command: PageCommand) -> tuple[bool, str]:
        heard.append(command)
        await asyncio.sleep(1000.0)
        return True, ""

    made = page_server(partial(answer_commands, execute=execute))
    yield made
    made.close()


def viewer(server: PageServer, **words: object) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{server.port}/socket", open_timeout=5.0, close_timeout=1.0, **words)


def status(server: PageServer, path: str, **headers: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=5.0)
    connection.request("GET", path, headers=headers)
    return connection.getresponse().status


def test_nothing_else_is_served_and_nothing_to_a_foreign_page_or_under_a_foreign_name(server: PageServer) -> None:
    assert status(server, "/") == 200
    for path in ("/no", "/../server.py", "/page/index.html", "/%2e%2e/server.py"):
        assert status(server, path) == 404
    assert status(server, "/", Host="evil.example") == 403
    with pytest.raises(InvalidStatus):
        viewer(server, origin="http://evil.example")
    viewer(server, origin=f"http://127.0.0.1:{server.port}").close()


def test_a_viewer_that_does_not_read_loses_frames_and_costs_nobody_anything(server: PageServer) -> None:
    deaf = socket.create_connection(("127.0.0.1", server.port))
    deaf.sendall(
        b"GET /socket HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    deaf.recv(1000)
    wait(lambda: server.viewers == 1)
    with viewer(server, max_queue=None) as reader:
        wait(lambda: server.viewers == 2)
        frame, took = b"x" * 65536, []
        for _ in range(400):  # 26 MB
            begin = time.monotonic()
            server.publish([frame], list)
            took.append(time.monotonic() - begin)
            assert reader.recv(30.0) == frame
        assert sorted(took)[360] < 0.05, "nine of ten; a machine may stand still"
    waiting = sum(one.transport.get_write_buffer_size() for one in server._viewers)
    assert waiting < page.BACKLOG_MAX + len(frame) + 2**20, "and what the sockets themselves may hold"
    deaf.close()


def test_viewers_and_what_they_send_are_bounded(server: PageServer, heard, capfd) -> None:
    viewers = [viewer(server) for _ in range(page.VIEWERS_MAX)]
    wait(lambda: server.viewers == page.VIEWERS_MAX)
    with pytest.raises(InvalidStatus):
        viewer(server)
    with pytest.raises(HTTPError) as refused:
        urlopen(server.address)
    assert b"16 pages look already: close one" in refused.value.read()
    with socket.create_connection(("127.0.0.1", server.port)) as garbage:
        garbage.sendall(bytes(range(256)) * 40 + b"\r\n\r\n")
        garbage.recv(100)
    assert "Traceback" not in "".join(capfd.readouterr())
    viewers[0].send("x" * 5000)
    with pytest.raises(Exception, match="1009"):
        viewers[0].recv(30.0)
    assert not heard
    for one in viewers:
        one.close()
    wait(lambda: server.viewers == 0)


def test_a_disarm_waits_for_no_other_command_and_none_for_ever(server: PageServer, heard, monkeypatch) -> None:
    monkeypatch.setattr(commands, "COMMAND_TIMEOUT", 0.5)
    with viewer(server) as sender:
        sender.send(b'{"command":"arm"}')
        sender.send(b'{"command":"disarm"}')
        wait(lambda: [one.command for one in heard] == ["arm", "disarm"])
        answers = [msgspec.json.decode(sender.recv(30.0)) for _ in range(2)]
    assert {(one["command"], one["success"], one["text"]) for one in answers} == {
        (command, False, "no answer within 0.5 s") for command in ("arm", "disarm")
    }


def test_a_port_that_is_taken_is_a_sentence_and_without_a_wish_another_is_found(
    server: PageServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UserError, match=f"port {server.port}"):
        page_server(port=server.port)
    monkeypatch.setattr(page, "PORT", server.port)
    other = page_server(port=None)
    assert other.port not in (0, server.port)
    other.close()


def test_disarm_needs_nothing_and_all_else_the_token_and_the_epoch_of_after_the_last_trip() -> None:
    now = 2**64 - 59  # JavaScript's numbers end at 2^53

    def sent(command: str, token: str = "right", epoch: str = str(now)) -> PageCommand:
        words = {"command": command, "token": token, "epoch": epoch, "kp": 60, "ki": 10, "seconds": 30}
        return msgspec.json.decode(msgspec.json.encode(words), type=PageCommand)

    for epoch in (0, 1, now):
        authorize(PageCommand(command="disarm"), "right", epoch)
        authorize(sent("disarm", token="wrong", epoch="7"), "right", epoch)
    for command in ("arm", "override", "release", "end", "freeze", "adapt"):
        authorize(sent(command), "right", now)
        for token in ("", "wrong", "righ", "right ", "ü"):
            with pytest.raises(UserError, match="token"):
                authorize(sent(command, token=token), "right", now)
        for seen in ("", "0", str(now - 1), "1.8446744073709552e19"):
            with pytest.raises(UserError, match="nothing was done"):
                authorize(sent(command, epoch=seen), "right", now)


def test_hostile_bytes_are_answered_in_a_sentence_and_move_nothing(server: PageServer, heard) -> None:
    with viewer(server) as sender:
        for data in (
            b"",
            b"\xff\xfe",
            b"{",
            b"[]",
            b'{"command":"fire"}',
            b'{"command":"arm","kp":"1"}',
            b'{"command":1e999}',
        ):
            sender.send(data)
            answer = msgspec.json.decode(sender.recv(30.0))
            assert not answer["success"] and answer["text"]
    assert not heard


def _luminance(colour: str) -> float:
    """Relative luminance of #rrggbb (WCAG 2.2)."""
    linear = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in linear]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_text_is_read_on_bright_and_on_dark_screens_and_pages_have_the_colours_of_the_palette() -> None:
    folder = resources.files("hydro_bridge")
    bright, dark = (folder / "pages/templates/palette.css").read_text().split("@media")
    palettes = [dict(re.findall(r"--(\w+): (#\w{6})", text)) for text in (bright, bright + dark)]
    texts, grounds = ("ink", "soft", "blue", "vermilion", "green", "brown"), ("paper", "ground", "tint")
    for palette in palettes:
        light = {name: _luminance(colour) + 0.05 for name, colour in palette.items()}
        for text, ground in product(texts, grounds):
            assert max(light[text] / light[ground], light[ground] / light[text]) >= 4.5, (text, ground)
        assert all(1.05 / light[surface] >= 4.5 for surface in ("armed", "alarm", "pressed", "idle")), light
    for style in ("pages/templates/report.css", "pages/static/page.css", "pages/static/view.css"):
        text = (folder / style).read_text()
        assert not re.search(r"#[0-9a-f]{3,6}\b", text), style
        assert set(re.findall(r"var\(--(\w+)\)", text)) <= palettes[0].keys(), style


@pytest.mark.graph
def test_bytes_that_are_no_message_leave_the_live_page_alone() -> None:
    rclpy = pytest.importorskip("rclpy")
    from hydro_bridge.nodes.dashboard import SampleReceiver
    from hydro_bridge.ros.topics import STATE, create_publisher
    from hydro_msgs.msg import BenchState

    with own_domain():
        rclpy.init()
        node, receiver = rclpy.create_node("stranger"), SampleReceiver()
        publisher = create_publisher(node, STATE)
        wait(lambda: publisher.get_subscription_count() == 1)
        publisher.publish(bytes(20))
        time.sleep(0.2)
        receiver.poll(1.0)
        assert receiver.taken_at < 0.0
        publisher.publish(BenchState(sequence=3, flags=4))
        wait(lambda: (receiver.poll(2.0), receiver.flags)[1] == 4)
        receiver.mailbox.close()
        node.destroy_node()
        rclpy.shutdown()
