# SPDX-License-Identifier: Apache-2.0
"""The page of a recording in a headless Chromium, opened from disk."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("selenium")

from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.signals import STATE_DTYPE, Flag
from hydro_bridge.viewer.view import read_recorded, rendered
from tests.browser import MISSING, Page, browser

pytestmark = pytest.mark.skipif(bool(MISSING), reason=MISSING)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """30 s: force 100 N + 1 N/s; armed from 10 s on, tripped at 20 s."""
    folder = Path(tmp_path_factory.mktemp("view"))
    states = np.zeros(30_000, STATE_DTYPE)
    states["time"] = 1_700_000_000.0 + 1e-3 * np.arange(len(states))
    states["sequence"] = np.arange(len(states))
    states["load_force"] = 100.0 + 1e-3 * np.arange(len(states))
    states["flags"][10_000:20_000] = int(Flag.ARMED)
    states["flags"][20_000:] = int(Flag.TRIPPED | Flag.FORCE_LIMIT)
    with BagWriter(folder / "bag") as writer:
        writer.write_states(states)
    (folder / "bag.html").write_text(rendered(read_recorded(folder / "bag")), encoding="utf-8")
    with browser(folder / "profile") as made:
        made.open((folder / "bag.html").as_uri())
        made.wait("!document.body.classList.contains('stale')", 120.0)
        yield made


def slide(page: Page, time: float) -> None:
    page.run(f"const s = document.getElementById('time'); s.value = {time}; s.dispatchEvent(new Event('input'))")


def test_it_opens_from_disk_without_errors_and_loads_nothing(page: Page) -> None:
    page.wait("document.getElementById('state').textContent == 'disarmed'")  # drawn once the data are unpacked
    assert "0.00 s of 30.0" in page.text("at").replace("29.99", "30.0").replace("30.00", "30.0")
    assert not page.driver.get_log("browser")
    loaded = page.run("return performance.getEntriesByType('resource').map((one) => one.name)")
    assert all(name.startswith("data:") for name in loaded)


def test_the_slider_shows_state_and_figures_of_its_time(page: Page) -> None:
    slide(page, 15.0)
    page.wait("document.getElementById('state').textContent == 'ARMED'")
    force = float(page.run("return document.querySelector('.plot b').textContent"))
    assert force == pytest.approx(115.0, abs=1.0)
    slide(page, 25.0)
    page.wait("document.getElementById('state').textContent == 'TRIPPED'")
