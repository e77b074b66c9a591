# SPDX-License-Identifier: Apache-2.0
"""Diagnosis: find, name, size and model physics that the simulation lacks. `pipeline.diagnose` runs the `stages`.

`io`, `preprocessing`, `wiring` (recordings); `effects` (the physics library), `model` (residuals), `estimation` (fits),
`selection` (names, places, verdict), `validation` (held-out recordings), `closure` (what has no name),
`experiment_design` (what to record next), `forecast` (control), `simulator_comparison` (a simulator beside the bench),
`report`; `import_page` (all of it in a browser).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hydro_diagnosis.pipeline import diagnose
    from hydro_diagnosis.recording import InputError
    from hydro_diagnosis.report.diagnosis import Diagnosis
    from hydro_diagnosis.report_json import Report

__all__ = ["Diagnosis", "InputError", "Report", "diagnose"]

_HOMES = {"Diagnosis": "report.diagnosis", "InputError": "recording", "Report": "report_json", "diagnose": "pipeline"}


def __getattr__(name: str) -> Any:
    """Import on first use: a command that diagnoses nothing, or only prints its help, starts fast."""
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
