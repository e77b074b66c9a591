# SPDX-License-Identifier: Apache-2.0
"""The hybrid-simulation benchmark against its published transfer function and errors."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from benchmarks.hybrid_simulation import __main__ as benchmark
from benchmarks.hybrid_simulation import plant
from benchmarks.hybrid_simulation.entries import ENTRIES

DATA = Path(os.environ.get("HYDRO_HYBRID_SIMULATION", "runs/hybrid_simulation"))


@pytest.mark.study
def test_plant_has_the_published_transfer_function() -> None:
    numerator, denominator = plant.transfer_function(plant.Actuator(), plant.Specimen())
    published = [29.13, 12590.599867147821, 8421776.502399411, 2328489633.084145, 543546586039.86615, 21675605752000.0]
    assert numerator == pytest.approx(21838486300000.0)
    assert denominator == pytest.approx(published, rel=1e-9)


@pytest.mark.study
@pytest.mark.skipif(not DATA.is_dir(), reason="the public ground motions are not here")
def test_entries_have_the_errors_that_another_port_measured() -> None:
    rows = benchmark.measured(DATA, [*ENTRIES[:7], "compensated", "oracle"], [1], ["El Centro"], 0, 1)
    errors = {(row["specimen"], row["entry"]): row["j2_true"] for row in rows}
    published = {"pi_p": (10.16, 8.48), "ats": (0.69, 2.45), "ats_fast": (0.32, 2.43), "amb": (0.38, 2.84),
                 "least_squares_3": (0.25, 2.51), "least_squares_4": (0.15, 2.60)}  # fmt: skip
    for entry, (linear, yielding) in published.items():
        assert errors["linear", entry] == pytest.approx(linear, abs=0.04), entry
        assert errors["yielding", entry] == pytest.approx(yielding, rel=0.02), entry
    assert max(errors[specimen, "oracle"] for specimen in ("linear", "yielding")) < 0.1
