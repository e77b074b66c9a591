# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import argparse
import json

import numpy as np
import pytest

from hydro_bridge.bag_writer import RecordingError
from hydro_bridge.console import Table, UserError, add_json_argument, command


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


def test_unknown_errors_keep_their_traceback():
    @command()
    def main() -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        main()


@pytest.mark.parametrize(("value", "status"), [(None, 0), (3, 3)])
def test_the_return_value_is_the_exit_status(value, status):
    @command()
    def main() -> int | None:
        return value

    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == status
