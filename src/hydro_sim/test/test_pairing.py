# SPDX-License-Identifier: Apache-2.0
"""Stamps: what a file was made for, and when that is not the box it meets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from hydro_bridge.files import bench_file
from hydro_sim.files import weights
from hydro_sim.files.pairing import BoxIdentity, MadeFor, header_of, mismatch, stamp_of, stamped
from hydro_sim.model.bench import Bench

BOX = BoxIdentity(digest="a", source="a.yaml", base_gains=(15.0, 5.0), integral="bumpless")


def test_a_digest_is_of_the_numbers_not_of_how_they_are_written(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text("# another comment\n" + yaml.safe_dump(bench.to_mapping(), sort_keys=True).replace("80.0", "80"))
    assert Bench.load(path).digest == bench.digest == bench_file.digest(bench_file.read_numbers(path))
    assert replace(bench, spring_stiffness=20000).digest == bench.digest
    assert replace(bench, spring_stiffness=20000.1).digest != bench.digest
    assert replace(bench, load_cell_bandwidth=None).digest != bench.digest


def test_what_was_made_for_this_box_fits_and_each_difference_is_one_sentence() -> None:
    made = MadeFor(box="a", model="m", base_kp=15.0, base_ki=5.0, integral="bumpless")
    assert mismatch("it", made, BOX, "remedy", model="m") == ""
    assert mismatch("it", replace(made, base_kp=None, base_ki=None, integral=""), BOX, "remedy", model="m") == ""
    assert mismatch("it", None, BOX, "remedy") == "it does not say which bench it was made for: remedy"
    for wrong, sentence in (
        (replace(made, box="b"), "it was made for bench b, the box believes a (a.yaml): remedy"),
        (replace(made, model="n"), "it was made for model n, it is to be used with model m: remedy"),
        (replace(made, base_ki=8.0), "it was made for a box with base K_i 8, this one has 5: remedy"),
        (replace(made, integral="paper"), "it was made for the paper integral, the box runs the bumpless one: remedy"),
    ):
        assert mismatch("it", wrong, BOX, "remedy", model="m") == sentence


def test_a_stamp_changes_no_tensor(tmp_path: Path) -> None:
    path, made = tmp_path / "metric.safetensors", MadeFor(box="b", model="m", base_kp=1.0, base_ki=2.0, any_bench=True)
    tensors = {"center": np.arange(3.0), "table": np.eye(2)}
    weights.save(path, tensors, {"structure": "metric"}, MadeFor(box="a"))
    path.write_bytes(stamped(path.read_bytes(), made))
    assert stamp_of(path) == made
    after = weights.load(path)[0]
    assert all(np.array_equal(tensors[name], after[name]) for name in after) and after.keys() == tensors.keys()
    path.write_bytes(stamped(path.read_bytes(), None))
    assert stamp_of(path) is None
    with pytest.raises(ValueError, match="no readable entry"):
        header_of(b"nonsense")
