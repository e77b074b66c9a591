# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium on the live page, for tests and measurements; where none is installed there is a sentence."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from selenium.webdriver import Chrome, ChromeOptions
from selenium.webdriver.chrome.service import Service

BROWSER = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), "")
DRIVER = shutil.which("chromedriver") or ""
MISSING = "" if BROWSER and DRIVER else "no Chromium with its driver here (Debian: chromium, chromium-driver)"
"""Why there is no browser; empty: there is one."""

_WORDS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--window-size=1500,1120", "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
)  # fmt: skip


class Page:
    """One window on the page."""

    def __init__(self, driver: Chrome) -> None:
        self.driver = driver

    def open(self, address: str) -> None:
        """Load the page."""
        self.driver.get(address)

    def run(self, script: str) -> Any:
        """What JavaScript gives."""
        return self.driver.execute_script(script)

    def text(self, name: str) -> str:
        """What stands in the element of that id."""
        return str(self.run(f"return document.getElementById('{name}').textContent"))

    def click(self, name: str) -> float:
        """Press the button of that id; when, in seconds of the machine's clock."""
        script = f"const t = Date.now(); document.getElementById('{name}').click(); return t"
        return 1e-3 * float(self.run(script))

    def enter(self, name: str, text: str) -> None:
        """Fill in the field of that id."""
        self.run(f"document.getElementById('{name}').value = '{text}'")

    def wait(self, script: str, timeout: float = 30.0, meanwhile: Callable[[], object] = lambda: None) -> float:
        """Wait until JavaScript gives true; how long it took [s]."""
        begin = time.monotonic()
        while not self.run(f"return Boolean({script})"):
            assert time.monotonic() < begin + timeout, (
                f"in vain: {script}; {self.run('return document.body.innerText')[:400]}"
            )
            meanwhile()
            time.sleep(0.02)
        return time.monotonic() - begin


@contextmanager
def browser(profile: Path) -> Iterator[Page]:
    """A new Chromium with the empty folder `profile` to itself. It resolves no name and so loads nothing from afar."""
    options = ChromeOptions()
    options.binary_location = BROWSER
    for word in (*_WORDS, f"--user-data-dir={profile}"):
        options.add_argument(word)
    driver = Chrome(options=options, service=Service(DRIVER))
    try:
        yield Page(driver)
    finally:
        driver.quit()
