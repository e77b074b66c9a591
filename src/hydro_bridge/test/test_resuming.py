# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import argparse

import pytest

from hydro_bridge.cli.console import UserError
from hydro_bridge.cli.resuming import NEW_ONLY, refuse_changes


def parser() -> argparse.ArgumentParser:
    options = argparse.ArgumentParser()
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--from", dest="start")
    options.add_argument("--bench")
    options.add_argument("--randomise", action="store_true")
    options.add_argument("--hidden", type=int, nargs="+", default=[32, 32])
    options.add_argument("--episodes", type=int, default=160)
    return options


BEGUN = {"seed": 5, "start": NEW_ONLY, "bench": None, "randomise": False, "hidden": [32, 32]}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--seed", "0"], "--seed 0 (it has 5)"),
        (["--from", "runs/b"], "--from runs/b"),
        (["--bench", "b.yaml"], "--bench b.yaml (it has none)"),
        (["--randomise", "--hidden", "8"], "--randomise and --hidden 8 (it has 32 32)"),
    ],
)
def test_words_that_say_otherwise_are_refused_in_one_sentence(words, told):
    with pytest.raises(UserError) as refused:
        refuse_changes(parser(), words, "runs/a", BEGUN)
    assert (
        str(refused.value) == f"runs/a resumes with the options of its start, without {told}: drop that, or start anew"
    )
