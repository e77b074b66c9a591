# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hydro_bridge.cli.console import UserError, command, writable, writable_folder
from hydro_bridge.files.atomic import write_whole


def test_a_file_that_the_system_refuses_is_one_sentence_without_a_number(tmp_path, capsys):
    (tmp_path / "file").touch()

    @command()
    def main() -> None:
        (tmp_path / "file" / "x").mkdir()

    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"error: {tmp_path / 'file' / 'x'}: Not a directory: choose another place\n"


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
    with pytest.raises(
        UserError, match=f"x cannot be {done}: {tmp_path / 'file'} is not a folder: choose another place"
    ):
        check(str(tmp_path / "file" / "deep" / "x"))
    assert str(check(str(tmp_path / "new" / "x"))) == str(tmp_path / "new" / "x")
    monkeypatch.setattr("os.access", lambda path, mode: False)  # root may write anywhere
    with pytest.raises(UserError, match=f"x cannot be {done}: you may not write to {tmp_path}: choose another place"):
        check(str(tmp_path / "new" / "x"))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """Within, the system refuses to let a file grow beyond `size` bytes, as a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    for content in (b"a" * 10_000, b"b"):
        write_whole(tmp_path / "file", content)
        assert (tmp_path / "file").read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_where_there_is_no_room_the_old_file_stays_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    write_whole(tmp_path / "file", b"whole")
    with files_of_at_most(1000), pytest.raises(OSError, match="too large") as refused:
        write_whole(tmp_path / "file", bytes(2000))
    assert refused.value.filename == str(tmp_path / "file"), "the system does not say which"
    assert (tmp_path / "file").read_bytes() == b"whole"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
