# SPDX-License-Identifier: Apache-2.0
"""Settings, words and places that cannot be used are told in one sentence; a file is replaced whole or not at all."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest

from hydro_core.cli.console import command
from hydro_core.errors import UserError, writable_file, writable_folder
from hydro_core.files.atomic import write_atomic
from hydro_core.files.tensors import InvalidTensorError, check_finite
from hydro_core.settings import SettingsError, add_options, described, from_mapping, quantity
from tests.checks import files_of_at_most, status_of


@dataclass(frozen=True, kw_only=True)
class Part:
    size: Annotated[float, quantity("m", 0.0, 1.0)]


@dataclass(frozen=True, kw_only=True)
class Example:
    rate: Annotated[float, quantity("1/s", -1.0, 1.0, "How fast")] = 0.0
    count: Annotated[int, quantity("-", 0, 9e15)] = 0
    limit: Annotated[float, quantity("A", 0.0, 1.0)] | None = None
    tones: tuple[Annotated[float, quantity("Hz", 0.05, 10.0)], ...] = (1.0,)
    form: Annotated[Literal["hard", "soft"], described("Of the corner")] = "hard"
    on: bool = False
    parts: tuple[Part, ...] = ()


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        ({"rate": 2}, "file.rate must be a number within [-1, 1] 1/s, not 2"),
        ({"rate": "fast"}, "file.rate must be a number within [-1, 1] 1/s, not 'fast'"),
        ({"count": 1.5}, "file.count must be a whole number within [0, 9e+15], not 1.5"),
        ({"limit": True}, "file.limit must be a number within [0, 1] A, not True"),
        ({"rate": 10**400}, f"file.rate must be a number within [-1, 1] 1/s, not {10**400}"),
        ({"tones": [1, 20]}, "file.tones must be numbers within [0.05, 10] Hz, not [1, 20]"),
        ({"form": "round"}, "file.form must be one of hard, soft, not 'round'"),
        ({"on": "often"}, "file.on must be true or false, not 'often'"),
        ({"rat": 1}, "file.rat is not a known setting; did you mean rate?"),
        ({"parts": [{"size": 0.1}, {}]}, "file.parts lacks size [m]"),
    ],
    ids=range(10),
)
def test_a_file_that_cannot_be_used_is_told_in_one_sentence(data, sentence):
    with pytest.raises(SettingsError) as error:
        from_mapping(Example, data, "file")
    assert str(error.value) == sentence


def test_numbers_may_be_written_as_yaml_reads_them():
    data = {"rate": "1e-1", "count": "1e3", "limit": None, "form": "soft", "parts": {"size": 1}}
    found = from_mapping(Example, data, "file")
    assert found == Example(rate=0.1, count=1000, form="soft", parts=(Part(size=1.0),))
    assert isinstance(found.count, int)


def test_options_have_type_default_and_help_of_their_settings():
    parser = argparse.ArgumentParser()
    add_options(parser, Example(rate=0.5), ("rate", "count", "on", "form"))
    assert vars(parser.parse_args(["--count", "3", "--on", "--form", "soft"])) == {
        "rate": 0.5, "count": 3, "on": True, "form": "soft",
    }  # fmt: skip
    assert "How fast [1/s, -1 to 1]" in " ".join(parser.format_help().split())


def test_a_file_that_the_system_refuses_is_one_sentence_and_a_reader_that_has_seen_enough_none(
    tmp_path, capsys, monkeypatch
):
    (tmp_path / "file").touch()
    assert status_of(command()((tmp_path / "file" / "x").mkdir)) == 2
    assert capsys.readouterr().err == f"error: {tmp_path / 'file' / 'x'}: Not a directory: choose another place\n"

    @command(OSError)
    def piped() -> None:
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("sys.stderr.close", lambda: None)
    assert status_of(piped) == 0 and capsys.readouterr().err == ""


@pytest.mark.parametrize("check", [writable_file, writable_folder])
def test_a_place_below_a_file_or_a_folder_of_others_is_refused_and_nothing_made(check, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    refusal = f"x cannot be written: {tmp_path / 'file'} is not a folder: choose another place"
    with pytest.raises(UserError, match=refusal):
        check(str(tmp_path / "file" / "deep" / "x"))
    assert str(check(str(tmp_path / "new" / "x"))) == str(tmp_path / "new" / "x")
    monkeypatch.setattr("os.access", lambda path, mode: False)  # root may write anywhere
    with pytest.raises(UserError, match=f"x cannot be written: you may not write to {tmp_path}: choose another place"):
        check(str(tmp_path / "new" / "x"))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_file_is_replaced_whole_or_stays_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    for content in (b"a" * 10_000, b"whole"):
        write_atomic(tmp_path / "file", content)
        assert (tmp_path / "file").read_bytes() == content
    with files_of_at_most(1000), pytest.raises(OSError, match="too large") as refused:
        write_atomic(tmp_path / "file", bytes(2000))
    assert refused.value.filename == str(tmp_path / "file"), "the system does not say which"
    assert (tmp_path / "file").read_bytes() == b"whole"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, 1e31])
def test_numbers_that_are_none_are_found_and_counted(number: float) -> None:
    with pytest.raises(InvalidTensorError, match=r"weights holds 2 of 12 values"):
        check_finite({"steps": np.array([3]), "weights": np.array([number, number, *range(10)])})
