# SPDX-License-Identifier: Apache-2.0
"""A table says what it was made under: plant, bench, filter, integral, and each controller's authority."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hydro_bridge.safety.box_info import KnownBox
from hydro_bridge.serial.frames import BoxInfo
from hydro_policy.evaluation import report
from hydro_policy.evaluation.conditions import Conditions
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.session import EvaluationSession, EvaluationSettings, Score
from hydro_policy.nodes.companions import PlantOptions
from hydro_policy.nodes.provenance import conditions
from hydro_policy.sessions.offline import OfflineGraph
from hydro_policy.task.mdp import GainRange
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

BOX = KnownBox(info=BoxInfo(base_kp=20.0, base_ki=5.0, integral="bumpless"), plant="bridge", bench_digest="abc")


def test_a_table_says_what_it_was_made_under(tmp_path: Path) -> None:
    made = Conditions(plant="emulator", bench="abc", filter="--metric learned", integral="bumpless")
    settings = EvaluationSettings(frequencies=(1.0,))
    graph = OfflineGraph(AnalyticPlant(Bench.nominal()), Bench.nominal())
    session = EvaluationSession(settings, [FixedGains(90.0, 15.0)], graph)
    session.scores.append(Score(controller="fixed (90, 15)", case="1 Hz", frequency=1.0, repeat=0, rmse=12.1))
    table = report.table(session, made)
    assert table.rows[0] == {"controller": "fixed (90, 15)", "authority": "90, 15", "1 Hz": 12.1}
    report.write_json(session, tmp_path / "e.json", made, {})
    assert json.loads((tmp_path / "e.json").read_text())["conditions"]["filter"] == "--metric learned"


def test_authority_is_what_the_gains_are_in_all() -> None:
    made = Conditions(plant="sim", bench="", filter="", base_gains=(20.0, 5.0))
    reach = GainRange(delta_kp_min=0.0, delta_kp_max=75.0, delta_ki_min=0.0, delta_ki_max=10.0)
    assert made.authority(reach) == "20 to 95, 5 to 15"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (
            PlantOptions(plant="emulator", filter=("--contraction-rate", "2")),
            "Plant emulator, truth default; box bench abc (/hydro/box of bridge); "
            "filter --metric learned --contraction-rate 2; integral bumpless",
        ),
        (
            PlantOptions(plant="external"),
            "Plant external; box bench abc (/hydro/box of bridge); filter the one that ran already; integral bumpless",
        ),
    ],
)
def test_conditions_are_those_of_the_plant(options: PlantOptions, sentence: str) -> None:
    made = conditions(options, BOX)
    assert made.sentence == sentence
    assert made.base_gains == (20.0, 5.0)
