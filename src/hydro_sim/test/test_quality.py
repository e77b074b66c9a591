# SPDX-License-Identifier: Apache-2.0
"""What a bench file says of how good it is, and what follows from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench
from hydro_sim.model.quality import Quality


def test_one_reading_far_off_is_unfit_however_good_the_mean_is() -> None:
    quality = Quality.of([1.0, 1.0, 1.0, 1.0, 240.0])
    assert quality.over_noise < 3.0 and quality.worst == 240.0
    assert "240 times the noise of piston_position, more than 10" in quality.unfit
    assert "NOT fit for the filter" in quality.told()


def test_a_poor_mean_is_unfit_and_noise_alone_is_not() -> None:
    assert "4 times the noise, more than 3" in Quality.of([4.0] * 5).unfit
    assert Quality.of([1.0, 1.0, 1.0, 1.0, 2.4]).unfit == ""
    assert "hints at an effect" in Quality.of([1.0, 1.0, 1.0, 1.0, 2.4]).told()
    assert Quality.of([1.0] * 5).told().endswith("1.00 times of hydraulic_force")


def test_the_filter_refuses_a_file_by_its_worst_reading(tmp_path: Path) -> None:
    bench = Bench.nominal()
    learned = {"bench": bench.digest, **Quality.of([1.0, 1.0, 1.0, 1.0, 240.0]).to_mapping()}
    file = tmp_path / "learnt.yaml"
    file.write_text(yaml.safe_dump(replace(bench, learned=learned).to_mapping()), encoding="utf-8")
    with pytest.raises(ValueError, match="240 times the noise of piston_position"):
        load_model(file)
    learned["worst"] = 2.0
    file.write_text(yaml.safe_dump(replace(bench, learned=learned).to_mapping()), encoding="utf-8")
    assert isinstance(load_model(file), Bench)
