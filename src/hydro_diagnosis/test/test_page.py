# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
from pathlib import Path


def test_page_needs_nothing_from_elsewhere(written: Path) -> None:
    page = (written / "report.html").read_text()
    assert not re.findall(r"""(?:src|href)=["'](?!#|data:)[^"']*""", page)
    assert not re.findall(r"@import|url\((?!#)", page)


def test_page_tells_what_a_cause_is_searched_for_from_what_is_left_after_it(written: Path) -> None:
    page = (written / "report.html").read_text()
    assert '<h2>Where the bench file alone is wrong</h2>\n<p class="quiet">Before any cause is added.</p>' in page
    assert "What remains unexplained" not in page, "all of it is explained"


def test_page_shows_how_well_the_corrected_model_follows_what_was_measured(written: Path) -> None:
    table = (written / "report.html").read_text().split("<h2>Measured and simulated</h2>")[1].split("</table>")[0]
    rows = dict(re.findall(r"<tr><td>([\w ]+)</td>(.*?)</tr>", table, re.DOTALL))
    assert {"piston position", "pressure A", "pressure B", "load force", "hydraulic force"} == set(rows)
    for name, row in rows.items():
        before, after = (float(cell) for cell in re.findall(r'<td class="n">([\d.-]+)</td>', row))
        assert after > 98.0 and after > before, name
