# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import argparse
import json

import numpy as np
import pytest

from hydro_bridge.bags.writer import RecordingError
from hydro_bridge.cli.console import (
    Table,
    UserError,
    add_json_argument,
    command,
    progress,
    writable,
    writable_folder,
)


def test_table_is_aligned_and_its_json_has_documented_keys(tmp_path, capsys):
    table = Table({"policy": "", "rmse": "force error [N]"}, title="Tracking")
    table.add(policy="fixed", rmse=12.34567)
    table.add(policy="learned one", rmse=np.float64("nan"))
    table.show(tmp_path / "table.json")
    assert capsys.readouterr().out.splitlines() == [
        "Tracking",
        "policy        rmse",
        "-----------  -----",
        "fixed        12.35",
        "learned one    nan",
        "rmse: force error [N]",
    ]
    assert json.loads((tmp_path / "table.json").read_text()) == {
        "title": "Tracking",
        "columns": {"policy": "", "rmse": "force error [N]"},
        "rows": [{"policy": "fixed", "rmse": 12.34567}, {"policy": "learned one", "rmse": None}],
    }


def test_a_row_must_have_every_column():
    with pytest.raises(ValueError, match="columns are a, b"):
        Table({"a": "", "b": ""}).add(a=1)


def test_a_json_file_that_cannot_be_written_is_refused_before_the_work_and_after_it(tmp_path, capsys):
    parser = argparse.ArgumentParser()
    add_json_argument(parser)
    (tmp_path / "file").touch()
    below = tmp_path / "file" / "table.json"
    for path, reason in ((below, f"{tmp_path / 'file'} is no folder"), (tmp_path, "a folder")):
        with pytest.raises(SystemExit) as ended:
            parser.parse_args(["--json", str(path)])
        assert ended.value.code == 2 and reason in capsys.readouterr().err
        with pytest.raises(UserError, match="cannot be written"):
            Table({"a": ""}).write_json(path)


def test_the_folder_of_a_json_file_is_made(tmp_path):
    parser = argparse.ArgumentParser()
    add_json_argument(parser)
    path = parser.parse_args(["--json", str(tmp_path / "new" / "folder" / "table.json")]).json
    assert not (tmp_path / "new").exists(), "not before there is something to write"
    Table({"a": ""}).write_json(path)
    assert json.loads((tmp_path / "new" / "folder" / "table.json").read_text())["rows"] == []


@pytest.mark.parametrize("error", [UserError("no bench here"), RecordingError("no bench here")])
def test_known_errors_are_one_sentence_with_exit_status_2(error, capsys):
    @command()
    def main() -> None:
        raise error

    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == "error: no bench here\n"


@pytest.mark.parametrize("known", [(), (OSError,)])
def test_a_file_that_the_system_refuses_is_one_sentence_without_a_number(known, tmp_path, capsys):
    (tmp_path / "file").touch()

    @command(*known)
    def main() -> None:
        (tmp_path / "file" / "x").mkdir()

    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"error: {tmp_path / 'file' / 'x'}: Not a directory: choose another place\n"


def test_a_full_disk_is_one_sentence_though_the_system_names_no_file(capsys):
    @command()
    def main() -> None:
        with open("/dev/full", "w", buffering=1) as full:
            full.write("a line\n")

    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == "error: No space left on device: choose another place\n"


@pytest.mark.parametrize("error", [ZeroDivisionError(), OSError("no file is to blame")])
def test_unknown_errors_keep_their_traceback(error):
    @command()
    def main() -> None:
        raise error

    with pytest.raises(type(error)):
        main()


def test_a_reader_that_has_seen_enough_is_no_error(monkeypatch, capsys):
    @command(OSError)
    def main() -> None:
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("sys.stderr.close", lambda: None)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0 and capsys.readouterr().err == ""


@pytest.mark.parametrize(("check", "done"), [(writable, "written"), (writable_folder, "made")])
def test_a_place_below_a_file_or_a_folder_of_others_is_refused_and_nothing_made(check, done, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=f"x cannot be {done}: {tmp_path / 'file'} is no folder: choose another place"):
        check(str(tmp_path / "file" / "deep" / "x"))
    assert str(check(str(tmp_path / "new" / "x"))) == str(tmp_path / "new" / "x")
    monkeypatch.setattr("os.access", lambda path, mode: False)  # root may write anywhere
    with pytest.raises(UserError, match=f"x cannot be {done}: you may not write to {tmp_path}: choose another place"):
        check(str(tmp_path / "new" / "x"))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_file_that_may_be_written_in_a_folder_that_may_not_is_refused(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr("os.access", lambda path, mode: path != tmp_path)
    with pytest.raises(UserError, match=f"file cannot be written: you may not write to {tmp_path}: choose another"):
        writable(str(tmp_path / "file"))
    assert writable("/dev/stdout") == "/dev/stdout"


def test_a_file_is_no_folder_and_a_folder_no_file(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="is a file: name a folder"):
        writable_folder(tmp_path / "file")
    with pytest.raises(UserError, match="is a folder: name a file"):
        writable(str(tmp_path))
    assert writable(str(tmp_path / "file")) and writable_folder(tmp_path) == tmp_path


@pytest.mark.parametrize(("value", "status"), [(None, 0), (3, 3)])
def test_the_return_value_is_the_exit_status(value, status):
    @command()
    def main() -> int | None:
        return value

    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == status


@pytest.mark.parametrize(("every", "lines"), [(None, 0), (0.0, 4)])
def test_progress_without_a_terminal_is_lines_where_asked(every, lines, capsys):
    assert list(progress(range(3), label="training", every=every)) == [0, 1, 2]
    said = capsys.readouterr().err.splitlines()
    assert len(said) >= lines and (lines > 0 or not said)
    assert all("training" in line and "\r" not in line for line in said)
