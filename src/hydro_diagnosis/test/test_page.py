# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SECTIONS = ("Measured and simulated", "Where", "Spring stiffness", "Held-out error", "Residuals of the first recording",
            "How evidence converged", "Checked equations")  # fmt: skip
PROBE = """<script>
function zooms(svg) {
  const whole = svg.viewBox.baseVal.width;
  svg.dispatchEvent(new WheelEvent("wheel", {deltaY: -1, clientX: 200, clientY: 300, cancelable: true}));
  const closer = svg.viewBox.baseVal.width < whole;
  svg.dispatchEvent(new MouseEvent("dblclick"));
  return closer && svg.viewBox.baseVal.width === whole;
}
addEventListener("load", () => {
  const box = (e) => e.getBoundingClientRect(), bad = [...document.images].filter((e) => !e.naturalWidth);
  document.title = JSON.stringify({
    sections: [...document.querySelectorAll("h2")].map((e) => e.firstChild.textContent),
    plots: [...document.querySelectorAll("svg")].filter((e) => box(e).width > 300 && box(e).height > 50).length,
    zooms: zooms(document.querySelector(".zoom svg")),
    missing: bad.length + [...document.querySelectorAll("use")].filter((e) =>
      !document.querySelector(e.getAttribute("xlink:href") || e.getAttribute("href"))).length,
    wide: document.documentElement.scrollWidth > innerWidth}); })</script>"""


def test_page_needs_nothing_from_elsewhere(written: Path) -> None:
    page = (written / "report.html").read_text()
    assert not re.findall(r"""(?:src|href)=["'](?!#|data:)[^"']*""", page)
    assert not re.findall(r"@import|url\((?!#)", page)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_page_in_a_real_browser(written: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text((written / "report.html").read_text().replace("</body>", PROBE + "</body>"))
    shown, log = browse(page, tmp_path, "--dump-dom", "--window-size=1280,800")
    title = re.search(r"<title>(.*?)</title>", shown)
    assert title is not None
    assert "CONSOLE" not in log, log
    for section in SECTIONS:
        assert f'"{section}"' in title[1], title[1]
    assert '"plots":5,"zooms":true,"missing":0,"wide":false' in title[1]


def test_page_shows_how_well_the_corrected_model_follows_what_was_measured(written: Path) -> None:
    table = (written / "report.html").read_text().split("<h2>Measured and simulated</h2>")[1].split("</table>")[0]
    rows = dict(re.findall(r"<tr><td>([\w ]+)</td>(.*?)</tr>", table, re.DOTALL))
    assert {"piston position", "pressure A", "pressure B", "load force", "hydraulic force"} == set(rows)
    for name, row in rows.items():
        before, after = (float(cell) for cell in re.findall(r'<td class="n">([\d.-]+)</td>', row))
        assert after > 98.0 and after > before, name


def browse(page: Path, folder: Path, *options: str) -> tuple[str, str]:
    assert CHROMIUM is not None
    quiet = ["--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"]
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", *quiet]
    ended = subprocess.run(
        [*command, f"--user-data-dir={folder / 'profile'}", *options, page.as_uri()],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    return ended.stdout, ended.stderr
