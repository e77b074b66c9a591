# SPDX-License-Identifier: Apache-2.0
"""Which policy of a run is compared with the one that it started from."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hydro_policy.nodes.training.run import paper_controllers
from hydro_policy.runs.run import TrainingSettings
from hydro_policy.sac.policy import Policy
from hydro_policy.sessions.training import TrainingSession


@pytest.mark.parametrize(
    ("bests", "name", "loaded"),
    [
        ([True, False, True], "I: policy, trained here", "best"),
        ([True, False, False], "I: last policy, trained here", "last"),
        ([], "I: last policy, trained here", "last"),
    ],
)
def test_the_last_policy_is_compared_where_none_was_better_than_the_initial_one(
    bests: list[bool], name: str, loaded: str
) -> None:
    policy = Policy(4)
    last, best = (
        np.full(sum(array.size for array in (*policy.weights, *policy.biases)), value) for value in (0.5, 0.25)
    )
    policy.load_flat(last)
    exams = [{"episode": episode, "best": best} for episode, best in enumerate(bests)]
    session: Any = SimpleNamespace(
        settings=TrainingSettings(), policy=policy, run=SimpleNamespace(best=best),
        progress=SimpleNamespace(exams=exams),
    )  # fmt: skip
    first = paper_controllers(cast(TrainingSession, session), None)[0]
    assert first.name == name
    assert policy.weights[0][0, 0] == {"best": 0.25, "last": 0.5}[loaded]
