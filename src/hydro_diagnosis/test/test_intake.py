# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import joblib
import numpy as np
import pytest

from hydro_diagnosis.intake import taken
from hydro_diagnosis.table import InputError
from hydro_sim.bench import Bench

BENCH = Bench.nominal()


@pytest.mark.parametrize("backend", ["loky", "threading"])
def test_recordings_read_side_by_side_are_the_same(backend: str, worn: list[Path]) -> None:
    fitted, held, notes = taken(worn[:2], worn[2:], BENCH)
    with joblib.parallel_config(backend=backend, n_jobs=2):
        fitted_too, held_too, notes_too = taken(worn[:2], worn[2:], BENCH)
    assert [one.recording for one in fitted_too] == ["run0", "run1"] == [one.recording for one in fitted]
    assert notes_too == notes
    for one, other in zip([*fitted, *held], [*fitted_too, *held_too], strict=True):
        np.testing.assert_array_equal(one.channels["load_force"], other.channels["load_force"])


def test_missing_recording_is_one_sentence_from_a_worker_too(worn: list[Path], tmp_path: Path) -> None:
    with (
        joblib.parallel_config(backend="loky", n_jobs=2),
        pytest.raises(InputError, match="there is no such recording"),
    ):
        taken([worn[0], tmp_path / "nowhere"], [], BENCH)
