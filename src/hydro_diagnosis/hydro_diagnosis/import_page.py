# SPDX-License-Identifier: Apache-2.0
"""`diagnose --page`: recordings dropped on a page in the browser, mapped, diagnosed and reported there.

::

    browser                              this process, one thread and one temporary folder per page
    upload {name, size}, bytes ...  ──>  saved; of the first recording: columns and the proposed map
    check {columns}                 ──>  what the map leaves out, what looks wrong in it, or why it cannot be read
    diagnose {columns, fit, check}  ──>  stages as they begin, then report, corrected bench and map, as text

Only pages of this machine are answered. What was uploaded is deleted when the page is closed; closing it ends a
diagnosis at its next stage.
"""

from __future__ import annotations

import http
import tempfile
import webbrowser
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve

from hydro_bridge.dashboard.server import file_response, is_cross_origin
from hydro_bridge.dashboard.status import encode_message
from hydro_bridge.pages import environment
from hydro_core.cli.console import Table
from hydro_core.errors import UserError
from hydro_diagnosis.bench_parameters import read_bench
from hydro_diagnosis.column_matching import as_yaml
from hydro_diagnosis.inspect_command import (
    COLUMNS,
    list_columns,
    missing_equations,
    plausibility_warnings,
    read_beginning,
)
from hydro_diagnosis.io.column_map import TARGETS, ColumnMap
from hydro_diagnosis.io.columns import UNIT_FACTORS, Columns
from hydro_diagnosis.recording import RECORDING_SUFFIXES, InputError, unreadable_reason
from hydro_diagnosis.stage_bar import STAGES
from hydro_sim.model.bench import Bench

if TYPE_CHECKING:
    from hydro_diagnosis.report.diagnosis import Diagnosis

HOST = "127.0.0.1"
_SCRIPT = "import.js"
_CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "connect-src 'self'; frame-src blob:"
)


class Upload(msgspec.Struct, tag="upload", frozen=True, forbid_unknown_fields=True):
    """Request to store a file, which follows in binary messages."""

    name: str
    size: int
    """Bytes."""


class Check(msgspec.Struct, tag="check", frozen=True, forbid_unknown_fields=True):
    """Request to check a column map."""

    columns: dict[str, dict[str, str]]
    """Source of each field: `column`, `unit`, `scale` and `offset`, as in a column map."""


class Diagnose(msgspec.Struct, tag="diagnose", frozen=True, forbid_unknown_fields=True):
    """Request to diagnose uploaded files with a column map."""

    columns: dict[str, dict[str, str]]
    fit: list[str]
    """Names of files to fit."""
    check: list[str]
    """Names of held-out files; empty: a part of the fitted ones is held out."""


_DECODER = msgspec.json.Decoder(Upload | Check | Diagnose)


class Import:
    """Session of one page: stores its uploads and answers its requests.

    `connection`: to the page. `folder`: of its uploads. `bench`: baseline, until the page sends a bench file.
    `diagnose`: `pipeline.diagnose`.
    """

    def __init__(
        self, connection: ServerConnection, folder: Path, bench: Bench, diagnose: Callable[..., Diagnosis]
    ) -> None:
        self._connection, self._folder, self._bench, self._run = connection, folder, bench, diagnose
        self._first: tuple[Path, Columns] | None = None
        """Recording whose columns are shown, with these columns."""

    def serve(self) -> None:
        """Answer requests until the page is closed."""
        for message in self._connection:
            if isinstance(message, bytes):
                continue  # the rest of a file that was refused
            name = ""
            try:
                request = _DECODER.decode(message)
                name = request.name if isinstance(request, Upload) else ""
                if isinstance(request, Upload):
                    self._take(request)
                elif isinstance(request, Check):
                    self._send("checked", **self._remarks(_map(request.columns)))
                else:
                    self._diagnose(request)
            except (InputError, UserError, OSError, ValueError, msgspec.DecodeError) as error:
                self._send("error", sentence=" ".join(str(error).replace(f"{self._folder}/", "").split()), name=name)

    def _remarks(self, columns: ColumnMap) -> Mapping[str, list[str]]:
        """Doubts about the first recording under this map, and equations for which the map lacks fields."""
        doubts = plausibility_warnings(*self._first, columns, self._bench) if self._first else []
        doubts += self._first[1].broken.values() if self._first else []
        return {"doubts": doubts, "missing": missing_equations(columns)}

    def _take(self, upload: Upload) -> None:
        """Receive a bench file or a recording; only the last part of a name's path is used."""
        path, left = self._folder / Path(upload.name).name, upload.size
        with path.open("wb") as file:
            while left > 0:
                piece = self._connection.recv()
                if isinstance(piece, str):
                    raise InputError(f"{path.name}: the page ended the file before its end")
                left -= file.write(piece)
        if path.suffix in (".yaml", ".yml"):
            self._bench = read_bench(path)
            self._send("bench", name=path.name)
            return
        if path.suffix.lower() not in (".mcap", *RECORDING_SUFFIXES):
            raise InputError(f"{path.name}: {unreadable_reason(path)}, nor a bench file")
        table = Table(COLUMNS)
        found = read_beginning(path)
        proposal = list_columns(path.name, found, None, table, self._bench)
        sources = {field: {"column": one.column, "unit": one.unit} for field, one in proposal.sources.items()}
        rows = [
            {key: f"{one:.4g}" if isinstance(one, float) else str(one) for key, one in row.items()}
            for row in table.rows
        ]
        self._first = self._first or (path, found)
        self._send("columns", name=path.name, rows=rows, proposed=sources, **self._remarks(proposal))

    def _diagnose(self, request: Diagnose) -> None:
        from hydro_diagnosis.report.corrected_bench import corrected_yaml
        from hydro_diagnosis.report.page import render_report

        columns = _map(request.columns)
        fit, check = ([self._folder / Path(name).name for name in names] for names in (request.fit, request.check))
        if not fit:
            raise InputError("no recording is there to fit: drop one")

        def progress(text: str) -> None:
            self._send("progress", text=text, done=STAGES.index(text) if text in STAGES else None, stages=len(STAGES))

        found = self._run(fit, holdout=check, bench=self._bench, columns=columns, progress=progress)
        self._send(
            "report", verdict=found.report.verdict, report=render_report(found),
            corrected=corrected_yaml(found.corrected), columns=as_yaml(columns),
        )  # fmt: skip

    def _send(self, kind: str, **content: Any) -> None:
        self._connection.send(encode_message(kind, content))


def _map(columns: Mapping[str, Mapping[str, str]]) -> ColumnMap:
    sources = {field: {key: one for key, one in source.items() if one} for field, source in columns.items()}
    loaded = ColumnMap.load(sources)
    assert loaded is not None
    return loaded


def serve_imports(port: int, diagnose: Callable[..., Diagnosis], bench: Bench, name: str = "the nominal one") -> Server:
    """Return a server of the page at `port` (0: any free one), to be run by `serve_forever`; `name`: of the bench.

    `diagnose`: `pipeline.diagnose`, which stands above this module.

    Raises UserError if the port is not available.
    """
    page = environment("hydro_diagnosis", "page").get_template("import.html")
    files = {
        "/": (
            page.render(title="Import recordings", fields=TARGETS, units=sorted(UNIT_FACTORS), bench=name).encode(),
            "text/html; charset=utf-8",
        ),
        f"/{_SCRIPT}": (
            (resources.files("hydro_diagnosis") / "page" / _SCRIPT).read_bytes(),
            "text/javascript; charset=utf-8",
        ),
    }

    def respond(connection: ServerConnection, request: Request) -> Response | None:
        if is_cross_origin(request, HOST):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "only a page of this machine is answered\n")
        if request.path == "/socket":
            return None
        if request.path not in files:
            return connection.respond(http.HTTPStatus.NOT_FOUND, "no such page\n")
        return file_response(*files[request.path], _CONTENT_SECURITY_POLICY)

    def attend(connection: ServerConnection) -> None:
        with tempfile.TemporaryDirectory(prefix="hydro-import-") as folder:
            try:
                Import(connection, Path(folder), bench, diagnose).serve()
            except ConnectionClosed:
                return

    try:
        # bytes in one message: the page sends files in pieces of half of that
        return serve(attend, HOST, port, process_request=respond, max_size=1 << 21)
    except OSError as error:
        raise UserError(f"the page cannot be served at port {port}: {error.strerror or error}") from None


def run(bench: str | None, port: int, diagnose: Callable[..., Diagnosis], *, opened: bool) -> int:
    """Serve the page until Ctrl-C, `opened` in a browser; `bench`: path of its file, None for the nominal one."""
    baseline, name = (read_bench(bench), [Path(bench).name]) if bench else (Bench.nominal(), [])
    with serve_imports(port, diagnose, baseline, *name) as server:
        address = f"http://{HOST}:{server.socket.getsockname()[1]}/"
        print(f"drop recordings on the page: {address} (Ctrl-C ends it)", flush=True)
        if opened:
            webbrowser.open(address)
        with suppress(KeyboardInterrupt):
            server.serve_forever()
    return 0
