# SPDX-License-Identifier: Apache-2.0
"""Find, name, size and model the physics that the simulation leaves out.

`intake`, `table`, `quality`: recordings; `effects`: the physics library; `model`, `chambers`, `problem`: residuals;
`screen`, `fit`, `search`: naming; `freeform`, `responses`, `locate`, `verdict`: what remains and where; `intervals`,
`heldout`, `simulate`: how sure, how good;
`report`, `page`, `corrected`: what is written. `pipeline.diagnose` puts them together.
"""

from __future__ import annotations

from hydro_diagnosis.pipeline import Diagnosis, diagnose
from hydro_diagnosis.report import Report
from hydro_diagnosis.table import InputError

__all__ = ["Diagnosis", "InputError", "Report", "diagnose"]
