# SPDX-License-Identifier: Apache-2.0
"""`diagnose --page`: recordings dropped on a page in the browser, mapped, diagnosed and reported there.

::

    browser                              this process, one temporary folder per page
    upload {name, size}, bytes ...  ──>  saved; of the first recording: columns and the proposed map
    check {columns}                 ──>  what the map leaves out, what looks wrong in it, or why it cannot be read
    diagnose {columns, fit, check}  ──>  stages as they begin, then report, corrected bench and map, as text

Only pages of this machine are answered. What was uploaded is deleted when the page is closed; closing it ends a
diagnosis at its next stage.
"""

from __future__ import annotations

import asyncio
import tempfile
import webbrowser
from collections.abc import Mapping
from contextlib import suppress
from importlib import resources
from pathlib import Path
from threading import Event
from typing import Literal

import msgspec
from websockets.asyncio.server import ServerConnection

from hydro_bridge.pages import environment
from hydro_bridge.pages.server import PageServer, encode_message
from hydro_core.cli.console import Table, format_cell
from hydro_core.errors import UserError
from hydro_diagnosis import inspect_command as inspection
from hydro_diagnosis.bench_parameters import read_bench
from hydro_diagnosis.column_matching import as_yaml
from hydro_diagnosis.io.column_map import TARGETS, ColumnMap
from hydro_diagnosis.io.columns import Columns
from hydro_diagnosis.io.units import UNIT_FACTORS
from hydro_diagnosis.pipeline import diagnose
from hydro_diagnosis.recording import RECORDING_SUFFIXES, InputError, unreadable_reason
from hydro_diagnosis.report.corrected_bench import corrected_yaml
from hydro_diagnosis.report.page import render_report
from hydro_diagnosis.stage_bar import STAGES
from hydro_diagnosis.stage_border import StageError
from hydro_sim.model.bench import Bench

POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "connect-src 'self'; frame-src blob:"
)


class Request(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request of the page."""

    type: Literal["upload", "check", "diagnose"]
    name: str = ""
    """Of the file to store, which follows in binary messages; and its size, bytes."""
    size: int = 0
    columns: dict[str, dict[str, str]] = {}
    """Source of each field: `column`, `unit`, `scale` and `offset`, as in a column map."""
    fit: list[str] = []
    """Names of files to fit."""
    check: list[str] = []
    """Names of held-out files; empty: a part of the fitted ones is held out."""


class Import:
    """Session of one page: stores its uploads and answers its requests.

    `connection`: to the page. `folder`: of its uploads. `bench`: baseline, until the page sends a bench file.
    """

    def __init__(self, connection: ServerConnection, folder: Path, bench: Bench) -> None:
        self._connection, self._folder, self._bench = connection, folder, bench
        self._first: tuple[Path, Columns] | None = None
        """Recording whose columns are shown, with these columns."""
        self._loop = asyncio.get_running_loop()

    async def serve(self) -> None:
        """Answer requests until the page is closed."""
        async for message in self._connection:
            if isinstance(message, bytes):
                continue  # the rest of a file that was refused
            name = ""
            try:
                request = msgspec.json.decode(message, type=Request)
                name = request.name
                if request.type == "upload":
                    await self._store(self._path(name), request.size)
                columns = ColumnMap.load(request.columns)
                answer = await asyncio.to_thread(getattr(self, f"_{request.type}"), request, columns)
            except (InputError, StageError, UserError, OSError, ValueError, msgspec.DecodeError) as error:
                sentence = " ".join(str(error).replace(f"{self._folder}/", "").split())
                answer = encode_message("error", sentence=sentence, name=name)
            await self._connection.send(answer)

    def _path(self, name: str) -> Path:
        """Return the place of an uploaded file; only the last part of its name is used."""
        return self._folder / Path(name).name

    async def _store(self, path: Path, size: int) -> None:
        with path.open("wb") as file:
            while file.tell() < size:
                if isinstance(piece := await self._connection.recv(), str):
                    raise InputError(f"{path.name}: the page ended the file before its end")
                file.write(piece)

    def _upload(self, request: Request, _: ColumnMap) -> str:
        path = self._path(request.name)
        if path.suffix in (".yaml", ".yml"):
            self._bench = read_bench(path)
            return encode_message("bench", name=path.name)
        if path.suffix.lower() not in (".mcap", *RECORDING_SUFFIXES):
            raise InputError(f"{path.name}: {unreadable_reason(path)}, nor a bench file")
        table, found = Table(inspection.COLUMNS), inspection.read_beginning(path)
        proposal = inspection.list_columns(path.name, found, None, table, self._bench)
        sources = {field: {"column": one.column, "unit": one.unit} for field, one in proposal.sources.items()}
        rows = [{key: format_cell(one) for key, one in row.items()} for row in table.rows]
        self._first = self._first or (path, found)
        return encode_message("columns", name=path.name, rows=rows, proposed=sources, **self._remarks(proposal))

    def _check(self, _: Request, columns: ColumnMap) -> str:
        return encode_message("checked", **self._remarks(columns))

    def _remarks(self, columns: ColumnMap) -> Mapping[str, list[str]]:
        """Doubts about the first recording under this map, and equations for which the map lacks fields."""
        doubts = inspection.plausibility_warnings(*self._first, columns, self._bench) if self._first else []
        doubts += self._first[1].broken.values() if self._first else []
        return {"doubts": doubts, "missing": inspection.missing_equations(columns)}

    def _diagnose(self, request: Request, columns: ColumnMap) -> str:
        fit, check = ([*map(self._path, names)] for names in (request.fit, request.check))
        if not fit:
            raise InputError("no recording is there to fit: drop one")

        def progress(text: str) -> None:
            done = STAGES.index(text) if text in STAGES else None
            told = encode_message("progress", text=text, done=done, stages=len(STAGES))
            asyncio.run_coroutine_threadsafe(self._connection.send(told), self._loop).result()

        found = diagnose(fit, holdout=check, bench=self._bench, columns=columns, progress=progress)
        return encode_message(
            "report",
            verdict=found.report.verdict,
            report=render_report(found),
            corrected=corrected_yaml(found.corrected),
            columns=as_yaml(columns),
        )


def serve_imports(port: int, bench: str | None = None) -> PageServer:
    """Return a server of the page at `port` (0: any free one); `bench`: path of the baseline, None: the nominal one.

    Raises InputError: the bench cannot be read. UserError: the port is not available.
    """
    baseline, name = (read_bench(bench), Path(bench).name) if bench else (Bench.nominal(), "the nominal one")

    async def attend(connection: ServerConnection) -> None:
        with tempfile.TemporaryDirectory(prefix="hydro-import-") as folder:
            await Import(connection, Path(folder), baseline).serve()

    page = environment("hydro_diagnosis", "page").get_template("import.html").render(
        title="Import recordings", fields=TARGETS, units=sorted(UNIT_FACTORS), bench=name
    )  # fmt: skip
    script = (resources.files("hydro_diagnosis") / "page/import.js").read_bytes()
    # the page sends files in pieces of half of the largest message
    return PageServer(
        {"/": page.encode(), "/import.js": script}, attend, policy=POLICY, message_size_max=1 << 21, port=port
    )


def run(bench: str | None, port: int, *, opened: bool) -> int:
    """Serve the page until Ctrl-C, `opened` in a browser; `bench`: path of its file, None for the nominal one."""
    server = serve_imports(port, bench)
    print(f"drop recordings on the page: {server.address} (Ctrl-C ends it)", flush=True)
    if opened:
        webbrowser.open(server.address)
    with suppress(KeyboardInterrupt):
        Event().wait()
    server.close()
    return 0
