# SPDX-License-Identifier: Apache-2.0
"""The live page in a headless Chromium, on a running emulator: seen at once, disarmed at once, armed by nobody else."""

from __future__ import annotations

import re
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("selenium")

from hydro_bridge.ros.companion import executable_path
from hydro_core.signals import Flag
from hydro_msgs.srv import Claim
from tests.attacks import Defended
from tests.browser import MISSING, Page, browser

pytestmark = [pytest.mark.graph, pytest.mark.skipif(bool(MISSING), reason=MISSING)]

ARMED = "document.getElementById('state').textContent == 'ARMED'"
DISARMED = "document.getElementById('state').textContent == 'disarmed'"
STALE = "document.body.classList.contains('stale')"


@contextmanager
def dashboard() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A dashboard on any free port, and the address with the token that it prints."""
    words = [str(executable_path("hydro_bridge", "dashboard")), "--port", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process, re.search(r"http://127\.0\.0\.1:\d+/#token=\S+", process.stdout.readline())[0]
        finally:
            process.kill()


@pytest.fixture(scope="module")
def page(graph: Defended, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with dashboard() as (_, address), browser(Path(tmp_path_factory.mktemp("profile"))) as made:
        made.open(address)
        yield made


def armed(graph: Defended, page: Page) -> None:
    graph.arm()
    page.wait(ARMED, meanwhile=lambda: graph.drive(0.05))


def test_it_loads_offline_shows_a_running_emulator_soon_and_drops_a_backlog(graph: Defended, page: Page) -> None:
    graph.arm()
    begin = time.monotonic()
    page.driver.refresh()
    page.wait(f"!{STALE} && {ARMED} && Number(document.querySelector('.plot b').textContent) != 0")
    took = time.monotonic() - begin
    print(f"shown after {took:.2f} s")
    loaded = page.run("return performance.getEntriesByType('resource').map((one) => new URL(one.name).hostname)")
    assert loaded and set(loaded) == {"127.0.0.1"}
    assert not page.driver.get_log("browser"), "no error, nothing that it missed"
    assert "#" not in page.driver.current_url, "the token has left the address bar"
    counted = "class extends WebSocket { constructor(...words) { super(...words); window.opened += 1; } }"
    page.run(f"window.opened = 0; window.WebSocket = {counted}")
    page.run("const end = performance.now() + 4000; while (performance.now() < end);")
    page.wait("window.opened == 1")
    page.wait(f"!{STALE}", 5.0)
    graph.drive(1.0)
    assert page.run("return window.opened") == 1 and not page.run(f"return {STALE}")


@pytest.mark.parametrize("way", ["button", "key"])
def test_disarm_leads_to_no_valve_current(graph: Defended, page: Page, way: str) -> None:
    armed(graph, page)
    graph.probe.forget()
    graph.drive(0.1)  # samples with a current, of which a fast answer would leave none
    if way == "button":
        clicked = page.click("disarm")
    else:
        event = "dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape', bubbles: true}))"
        clicked = 1e-3 * page.run(f"const t = Date.now(); document.getElementById('kp').{event}; return t")
    took = graph.valve_closed_at() - clicked
    print(f"valve current 0 after {1e3 * took:.0f} ms")
    page.wait(DISARMED)


def test_armed_in_two_presses_with_the_token_and_by_nobody_without_or_late(graph: Defended, page: Page) -> None:
    armed(graph, page)
    late = Claim.Request(act=Claim.Request.ARM, name="late", epoch=graph.epoch)
    graph.probe.arm(False)
    page.wait(DISARMED)
    answer = graph.probe.arming.call_async(late)
    graph.probe.wait(answer.done)
    assert not answer.result().success and "look, and ask again" in answer.result().message
    token = page.run("return document.getElementById('token').value")
    for wrong in ("", "wrong"):
        page.enter("token", wrong)
        page.run("document.getElementById('answer').textContent = ''")
        for _ in range(10):  # two presses within seconds: a machine may stand still between them
            page.click("arm")
            graph.drive(0.5)
            if "token" in page.text("answer"):
                break
        assert "token" in page.text("answer")
        graph.drive(0.3)
        assert not graph.probe.flags() & Flag.ARMED
    page.enter("token", token)
    page.run("const arm = document.getElementById('arm'); arm.click(); arm.click()")
    graph.drive(0.5)
    assert not graph.probe.flags() & Flag.ARMED, "one press is none, nor is one that bounces"
    page.click("arm")
    page.wait(ARMED, meanwhile=lambda: graph.drive(0.05))


def test_a_dashboard_that_hangs_or_dies_is_seen_and_no_matter_to_an_armed_plant(
    graph: Defended, tmp_path: Path
) -> None:
    with dashboard() as (process, address), browser(tmp_path) as page:
        page.open(address)
        armed(graph, page)
        graph.probe.forget()
        process.send_signal(19)  # SIGSTOP
        page.wait(STALE, meanwhile=lambda: graph.drive(0.05))
        graph.drive(2.0)
        process.kill()
        graph.drive(2.0)
        assert "No connection" in page.text("banner")
    states = graph.probe.states
    assert all(state.flags & Flag.ARMED for state in states)


def test_a_dead_plant_is_seen_as_dead(graph: Defended, page: Page) -> None:
    armed(graph, page)
    next(one for one in graph.companions if one.name == "filtered_plant").stop()
    print(f"seen after {page.wait(STALE):.2f} s")
    assert "silent" in page.text("banner")
    assert page.text("state") == "NOT LIVE"
