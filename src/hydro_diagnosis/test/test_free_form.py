# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydro_core.signals import FloatArray
from hydro_diagnosis import diagnose
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.problem import CHANNELS, Layout
from hydro_diagnosis.selection.localisation import free_forms
from hydro_diagnosis.stages.reporting import line_of
from hydro_sim.model.bench import Bench
from tests.segments import frame, problem_of, record


def test_free_form_of_viscous_friction_has_its_place_and_slope() -> None:
    problem = problem_of(viscous_friction=90.0)
    best = free_forms(problem, fit(problem, ()))[0]
    assert (best.equation, best.variable) == ("motion", "velocity")
    inner = slice(4, -4)
    slope = np.polyfit(best.knots[inner], best.values[inner], 1)[0]
    assert abs(slope) == pytest.approx(90.0 - Bench.nominal().viscous_friction, rel=0.05)


@pytest.mark.study
def test_ripple_that_no_cause_makes_is_called_unknown(tmp_path: Path) -> None:
    paths = []
    for seed in (5, 6):
        states = record(Bench.nominal(), seed, seconds=8.0)
        states["load_force"] += 8.0 * np.sin(states["piston_position"] * (2.0 * np.pi / 3e-3))
        paths.append(tmp_path / f"run{seed}.csv")
        frame(states).to_csv(paths[-1], index=False)
    report = diagnose(paths[:1], holdout=paths[1:]).report
    assert report.verdict == "unknown"
    assert report.effects == []
    assert report.remainder is not None and "position" in report.remainder["depends_on"]


STEP, COUNT = 5e-3, 5000
LOAD = CHANNELS.index("load")


def part(*signals: FloatArray) -> tuple[Layout, FloatArray]:
    """Residuals of the load, a recording each."""
    count = len(signals)
    layout = Layout(np.full(count * COUNT, LOAD), np.repeat(np.arange(count), COUNT), np.tile(TIME, count))
    return layout, np.concatenate(signals)


TIME = STEP * np.arange(COUNT)


def noise(seed: int) -> FloatArray:
    return np.random.default_rng(seed).standard_normal(COUNT)


def wave(frequency: float, phase: float, size: float = 3.0) -> FloatArray:
    return np.asarray(size * np.sin(2.0 * np.pi * frequency * TIME + phase))


@pytest.mark.parametrize("frequency", [7.03, 50.0, 91.4])
def test_a_line_is_told_with_frequency_and_share_whatever_its_phase(frequency: float) -> None:
    """Beside as much that does not repeat: a random walk whose power is that of the line."""
    other = [np.convolve(noise(seed), np.ones(40), "same") for seed in (5, 6, 7)]
    walks = [3.0 / np.sqrt(2.0) * one / one.std() for one in other]
    fitted = part(noise(1) + wave(frequency, 0.3) + walks[0], noise(2) + wave(frequency, 2.0) + walks[1])
    held = part(noise(3) + wave(frequency, 4.0) + walks[2])
    found = line_of((fitted, held), "load")
    assert found.frequency == pytest.approx(frequency, abs=0.03)
    assert found.share == pytest.approx(0.5, abs=0.05)
    assert f"{found.frequency:.3g} Hz" in found.sentence


@pytest.mark.parametrize(
    "held",
    [noise(3), noise(3) + wave(21.0, 4.0), np.convolve(noise(3), np.ones(40), "same"), noise(3) + wave(20.0, 0.0, 0.1)],
    ids=["noise", "another", "walk", "faint"],
)
def test_a_line_that_not_every_recording_has_is_not_told(held: FloatArray) -> None:
    assert line_of((part(noise(1) + wave(20.0, 0.3)), part(held)), "load") is None
