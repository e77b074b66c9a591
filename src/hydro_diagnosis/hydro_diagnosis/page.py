# SPDX-License-Identifier: Apache-2.0
"""report.html."""

from __future__ import annotations

from pathlib import Path

from hydro_diagnosis.pipeline import Diagnosis


def write_page(found: Diagnosis, path: Path) -> None:
    """Write report.html."""
    path.write_text(f"<pre>{found.report.to_json()}</pre>", encoding="utf-8")
