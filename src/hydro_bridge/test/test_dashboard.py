# SPDX-License-Identifier: Apache-2.0
"""The page's server: its files, several viewers, one that does not read; what it is told, and who may do what."""

from __future__ import annotations

import http.client
import re
import socket
import time
from collections.abc import Iterator
from concurrent.futures import Future
from importlib import resources

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from hydro_bridge.dashboard.server import (
    BACKLOG_MAX,
    COMMANDS,
    VIEWERS_MAX,
    PageServer,
    RefusedError,
    authorize,
    parse_command,
)
from hydro_core.errors import UserError
from tests.checks import wait


class Answers:
    """Answers `now` at once, and everything else never."""

    def __init__(self) -> None:
        self.heard: list[str | bytes] = []

    def __call__(self, text: str | bytes) -> Future[str]:
        self.heard.append(text)
        told: Future[str] = Future()
        if text == "now":
            told.set_result("done")
        return told


@pytest.fixture
def answers() -> Answers:
    return Answers()


@pytest.fixture
def server(answers: Answers) -> Iterator[PageServer]:
    made = PageServer(answers, port=0)
    yield made
    made.close()


def viewer(server: PageServer, **words: object) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{server.port}/live", open_timeout=5.0, close_timeout=1.0, **words)  # type: ignore[arg-type]


def seen(server: PageServer, count: int) -> None:
    wait(lambda: server.viewers == count)


def get(server: PageServer, path: str, **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=5.0)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


def test_nothing_else_is_served_and_nothing_to_a_foreign_page_or_under_a_foreign_name(server: PageServer) -> None:
    assert get(server, "/")[0] == 200
    for path in ("/no", "/../server.py", "/page/index.html", "/%2e%2e/server.py"):
        assert get(server, path)[0] == 404
    assert get(server, "/", Host="evil.example")[0] == 403
    with pytest.raises(InvalidStatus):
        viewer(server, origin="http://evil.example")
    with viewer(server, origin=f"http://127.0.0.1:{server.port}"):
        pass


def test_a_viewer_that_does_not_read_loses_frames_and_costs_nobody_anything(server: PageServer) -> None:
    deaf = socket.create_connection(("127.0.0.1", server.port))
    deaf.sendall(
        b"GET /live HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    deaf.recv(1000)
    seen(server, 1)
    with viewer(server, max_queue=None) as page:
        seen(server, 2)
        frame, took = b"x" * 65536, []
        for _ in range(400):  # 26 MB
            begin = time.monotonic()
            server.publish([frame], list)
            took.append(time.monotonic() - begin)
            assert page.recv(30.0) == frame
        assert sorted(took)[360] < 0.05, "nine of ten; a machine may stand still"
    kernel = 8 * 2**20  # what the sockets themselves may hold
    waiting = sum(one.transport.get_write_buffer_size() for one in server._viewers)
    assert waiting < BACKLOG_MAX + len(frame) + kernel // 8
    deaf.close()


def test_viewers_and_what_they_send_are_bounded(server: PageServer, answers: Answers) -> None:
    pages = [viewer(server) for _ in range(VIEWERS_MAX)]
    seen(server, VIEWERS_MAX)
    with pytest.raises(InvalidStatus):
        viewer(server)
    pages[0].send("x" * 5000)
    with pytest.raises(Exception, match="1009"):
        pages[0].recv(30.0)
    assert not answers.heard
    for page in pages:
        page.close()
    seen(server, 0)


def test_a_port_that_is_taken_is_a_sentence_and_without_a_wish_another_is_found(
    server: PageServer, answers: Answers, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UserError, match=f"port {server.port}"):
        PageServer(answers, port=server.port)
    monkeypatch.setattr("hydro_bridge.dashboard.server.PORT", server.port)
    other = PageServer(answers)
    assert other.port not in (0, server.port)
    other.close()


EPOCH = 2**64 - 59
"""JavaScript's numbers end at 2^53."""


def asked(command: str, **words: object) -> bytes:
    return msgspec.json.encode(
        {"command": command, "epoch": str(EPOCH), "token": "right", "kp": 60, "ki": 10, "seconds": 30, **words}
    )


def test_disarm_needs_nothing_and_all_else_the_token_and_the_epoch_of_after_the_last_trip() -> None:
    for epoch in (0, 1, EPOCH):
        authorize(parse_command(b'{"command":"disarm"}'), "right", epoch)
        authorize(parse_command(asked("disarm", token="wrong", epoch="7")), "right", epoch)
    for command in sorted({*COMMANDS} - {"disarm"}):
        authorize(parse_command(asked(command)), "right", EPOCH)
        for token in ("", "wrong", "righ", "right ", "ü"):
            with pytest.raises(RefusedError, match="token"):
                authorize(parse_command(asked(command, token=token)), "right", EPOCH)
        for seen in ("", "0", str(EPOCH - 1), "1.8446744073709552e19"):
            with pytest.raises(RefusedError, match="nothing was done"):
                authorize(parse_command(asked(command, epoch=seen)), "right", EPOCH)


@settings(deadline=None, max_examples=50)
@given(st.binary(max_size=200))
def test_hostile_bytes_end_in_a_sentence(data: bytes) -> None:
    with pytest.raises(RefusedError):
        parse_command(data)


def _luminance(colour: str) -> float:
    """Relative luminance of #rrggbb (WCAG 2.2)."""
    linear = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in linear]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_text_is_read_on_bright_and_on_dark_screens_and_pages_have_no_colours_of_their_own() -> None:
    pages = resources.files("hydro_bridge")
    bright, dark = (pages / "pages/templates/palette.css").read_text().split("@media")
    palettes = [dict(re.findall(r"--(\w+): (#\w{6})", text)) for text in (bright, bright + dark)]
    for palette in palettes:
        for text in ("ink", "soft", "blue", "vermilion", "green", "brown"):
            for ground in ("paper", "ground", "tint"):
                light, dim = sorted((_luminance(palette[text]), _luminance(palette[ground])), reverse=True)
                assert (light + 0.05) / (dim + 0.05) >= 4.5, (text, ground, palette[text], palette[ground])
        for surface in ("armed", "alarm", "pressed", "idle"):
            assert 1.05 / (_luminance(palette[surface]) + 0.05) >= 4.5, surface
    for style in ("pages/templates/report.css", "dashboard/page/page.css", "viewer/page/view.css"):
        text = (pages / style).read_text()
        assert not re.search(r"#[0-9a-f]{3,6}\b", text), style
        assert set(re.findall(r"var\(--(\w+)\)", text)) <= palettes[0].keys(), style
    assert "@media (max-width: 600px)" in (pages / "dashboard/page/page.css").read_text()
