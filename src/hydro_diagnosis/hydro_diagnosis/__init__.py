# SPDX-License-Identifier: Apache-2.0
"""Find, name, size and model the physics that the simulation leaves out. `pipeline.diagnose` puts the stages together.

Stages: `formats`, `io`, `preprocessing`, `wiring`, `dataset` (recordings); `effects` (the physics library), `model`
(residuals), `estimation` (fits), `selection` (names, places, verdict), `validation` (held-out recordings),
`experiment_design` (what to record next), `report`; `calibration` and `blind_benchmark` measure the diagnosis itself.
"""

from __future__ import annotations

from hydro_diagnosis.findings import Report
from hydro_diagnosis.io.table import InputError
from hydro_diagnosis.pipeline import diagnose
from hydro_diagnosis.report.diagnosis import Diagnosis

__all__ = ["Diagnosis", "InputError", "Report", "diagnose"]
