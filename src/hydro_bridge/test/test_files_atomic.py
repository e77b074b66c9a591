# SPDX-License-Identifier: Apache-2.0
"""A file is replaced whole or not at all, also where the disk takes no more; numbers out of files are looked at."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.files.atomic import write_whole
from hydro_bridge.files.tensors import UnsoundError, check_numbers


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


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, 1e31])
def test_numbers_that_are_none_are_found_and_counted(number: float) -> None:
    with pytest.raises(UnsoundError, match=r"weights holds 2 of 12 values"):
        check_numbers({"steps": np.array([3]), "weights": np.array([number, number, *range(10)])})
