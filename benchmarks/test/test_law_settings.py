# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.law_settings import changed, law_of, run, variant
from hydro_core.settings import SettingsError
from hydro_policy.compensation.estimator import Compensator, CompensatorSettings


@pytest.mark.study
def test_the_law_of_git_is_the_law_and_a_pinned_term_is_not_learnt(tmp_path: Path) -> None:
    pinned = variant(CompensatorSettings(), ["b_1", "b_3"])
    laws = {"as it is": Compensator, "of git": law_of("HEAD", tmp_path), "pinned": pinned}
    found = {name: np.array([row["rmse"] for row in rows]) for name, rows in run(laws, 1, 5).items()}
    np.testing.assert_array_equal(found["of git"], found["as it is"])
    assert np.max(np.abs(found["pinned"] / found["as it is"] - 1.0)) > 0.01


def test_what_is_no_setting_is_refused() -> None:
    assert changed(["bandwidth=10", "reversal=60"]) == CompensatorSettings(bandwidth=10.0, reversal=60.0)
    for word in ("bandwith=10", "bandwidth", "bandwidth=1e9"):
        with pytest.raises(SettingsError, match=r"band|--set"):
            changed([word])
