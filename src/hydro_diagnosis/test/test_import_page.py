# SPDX-License-Identifier: Apache-2.0
"""The page that recordings are dropped on: from files to a report, by its socket and in a real browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from hydro_core.signals import StateArray
from hydro_diagnosis.import_page import serve_imports
from hydro_sim.model.bench import Bench
from tests import browser

FIELDS = {"x": ("piston_position", 1e3), "pa": ("pressure_a", 1e-5), "pb": ("pressure_b", 1e-5),
          "f_load": ("load_force", 1e-3), "i": ("valve_current", 1e3)}  # fmt: skip


@pytest.fixture
def address() -> Iterator[str]:
    server = serve_imports(0)
    yield f"127.0.0.1:{server.port}"
    server.close()


@pytest.fixture
def recordings(tmp_path: Path, nominal: StateArray) -> list[Path]:
    paths = [tmp_path / "monday.csv", tmp_path / "tuesday.csv"]
    for path, part in zip(paths, (nominal[:6000], nominal[6000:10000]), strict=True):
        rows = np.column_stack([1e3 * part["time"], *(part[field] * scale for field, scale in FIELDS.values())])
        np.savetxt(path, rows, fmt="%.9g", delimiter=",", header=",".join(["t", *FIELDS]), comments="")
    return paths


def asked(page: ClientConnection, kind: str, file: bytes = b"", **content: Any) -> dict[str, Any]:
    """What the page is answered."""
    page.send(msgspec.json.encode({"type": kind, **content}).decode())
    for at in range(0, len(file), 100_000):
        page.send(file[at : at + 100_000])
    return dict(msgspec.json.decode(page.recv(timeout=120.0)))


def uploaded(page: ClientConnection, name: str, file: bytes) -> dict[str, Any]:
    return asked(page, "upload", file, name=name, size=len(file))


REFUSED = (
    ("../../notes.docx", b"x" * 300_000, "nor a bench file"), ("a.xlsx", b"PK", "save its table as CSV"),
    ("a.csv", b"", "is empty"), ("page.csv", b"<html></html>", "web page"),
    ("bench.yaml", b"piston_area: [", "bench.yaml"),
)  # fmt: skip


def test_what_is_no_recording_is_one_sentence_and_the_page_goes_on(address: str, recordings: list[Path]) -> None:
    with connect(f"ws://{address}/socket", max_size=None) as page:
        for name, content, sentence in REFUSED:
            refused = uploaded(page, name, content)
            assert sentence in refused["sentence"] and refused["name"] == name
        found = uploaded(page, "monday.csv", recordings[0].read_bytes())
        proposed = found["proposed"]
        assert proposed["time"] == {"column": "t", "unit": "ms"} and proposed["load_force"]["unit"] == "kN"
        assert len(found["rows"]) == 6 and any("hydraulic_force" in sentence for sentence in found["missing"])
        checked = asked(page, "check", columns={**proposed, "pressure_a": {"column": "pa", "unit": "kPa"}})
        assert "pressure_a is in bar, not kPa" in checked["doubts"][0]
        assert uploaded(page, "known.yaml", b"piston_area: 4.9e-4")["kind"] == "bench"
        begun = asked(page, "diagnose", columns={"time": {"column": "t"}}, fit=["../monday.csv"], check=[])
        assert begun["kind"] in ("error", "progress")


def test_a_page_of_another_host_is_refused(address: str) -> None:
    with pytest.raises(InvalidStatus, match="403"), connect(f"ws://{address}/socket", origin="http://example.org"):
        pass


@pytest.mark.skipif(bool(browser.MISSING), reason=browser.MISSING)
def test_a_person_gets_from_files_to_the_report(address: str, recordings: list[Path], tmp_path: Path) -> None:
    with browser.browser(tmp_path / "profile") as page:
        page.open(f"http://{address}/")
        assert page.text("bench") == "the nominal one"
        (tmp_path / "rig.yaml").write_text(yaml.safe_dump(Bench.nominal().to_mapping()))
        files = [*recordings, tmp_path / "rig.yaml"]
        page.run("window.early = false; new MutationObserver(() => { window.early ||= document.getElementById('list')"
                 ".rows.length === 1 && !document.getElementById('run').disabled })"
                 ".observe(document.body, { subtree: true, childList: true, attributes: true })")  # fmt: skip
        page.driver.find_element("id", "files").send_keys("\n".join(map(str, files)))
        page.wait("document.querySelectorAll('#list tr').length == 2")
        assert page.run("return document.querySelectorAll('#columns select')[1].value") == "piston_position"
        page.run("document.querySelectorAll('#columns input[name=offset]')[1].value = '0'")
        page.run("const last = document.querySelectorAll('#list select')[1]; last.value = 'check'; last.onchange()")
        page.click("run")
        page.wait("!document.getElementById('result').hidden", timeout=120.0)
        assert page.text("stage") == "no mismatch" and page.text("error") == ""
        assert page.run("const bar = document.getElementById('bar'); return bar.value === bar.max")
        assert page.text("bench") == "rig.yaml" and page.text("loading") == ""
        assert not page.run("return window.early"), "Diagnose can be pressed while a file is being read"
        assert page.run("return document.getElementById('save-corrected').href").startswith("blob:")
