# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML page of a recording: the live page's plots, styles and scripts, with embedded series.

The series are float32, gzipped, in base64, and unpacked by the browser. The modules import each other through an import
map of `data:` addresses, so that they are the live page's own files, unchanged. No external resource is loaded.
"""

from __future__ import annotations

import base64
import gzip
from datetime import datetime, timezone
from functools import cache
from importlib import resources
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from hydro_bridge.dashboard import series
from hydro_bridge.pages import environment
from hydro_bridge.viewer.recorded import Recorded

_POLICY = "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; img-src data:"


def rendered(recorded: Recorded) -> str:
    """Return the page as HTML."""
    imports = {f"./{name}": _module(f"dashboard/page/{name}") for name in ("plots.js", "series.js")}
    styles = ("dashboard/page/uPlot.min.css", "dashboard/page/page.css", "viewer/page/view.css")
    return environment("hydro_bridge", "viewer/page").get_template("view.html").render(
        policy=_POLICY,
        title=f"{_name(recorded)} - hydro",
        name=_name(recorded),
        begin=datetime.fromtimestamp(recorded.begin, timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC"),
        styles=[_text(name) for name in styles],
        uplot=_text("dashboard/page/uPlot.iife.min.js"),
        imports=imports,
        script=_text("viewer/page/view.js"),
        facts=_facts(recorded),
        messages=dict(sorted(recorded.messages.items())),
        notes=recorded.notes,
        about=_about(recorded),
        states=_packed(recorded.values[0]),
        corrections=_packed(recorded.values[1]),
        laws=_packed(recorded.values[2]),
    )  # fmt: skip


def _name(recorded: Recorded) -> str:
    folder = recorded.path.resolve()
    return f"{folder.parent.name}/{folder.name}" if folder.parent.name else folder.name


def _facts(recorded: Recorded) -> dict[str, str]:
    facts = {"length": f"{recorded.seconds:.1f} s", "finest detail": f"{1e3 * recorded.slot:g} ms", **recorded.metadata}
    return {**facts, **({"attached": ", ".join(recorded.attachments)} if recorded.attachments else {})}


def _about(recorded: Recorded) -> dict[str, Any]:
    """Return the script's data as JSON; non-finite values become null."""
    marks = [{"time": round(mark.time, 3), "kind": mark.kind, "text": mark.text} for mark in recorded.marks]
    about = {
        "seconds": recorded.seconds,
        "slot": recorded.slot,
        "series": series.described(),
        "marks": marks,
        "curve": recorded.curve,
    }
    return dict(msgspec.to_builtins(msgspec.json.decode(msgspec.json.encode(about))))


def _packed(values: npt.NDArray[np.float32]) -> str:
    return base64.b64encode(gzip.compress(np.ascontiguousarray(values, "<f4").tobytes(), 6, mtime=0)).decode()


def _module(name: str) -> str:
    return f"data:text/javascript;base64,{base64.b64encode(_text(name).encode()).decode()}"


@cache
def _text(name: str) -> str:
    return resources.files("hydro_bridge").joinpath(name).read_text(encoding="utf-8")
