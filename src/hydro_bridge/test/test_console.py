# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json

import numpy as np
import pytest

from hydro_bridge.bag_writer import RecordingError
from hydro_bridge.console import Table, UserError, command


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
