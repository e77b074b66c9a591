# SPDX-License-Identifier: Apache-2.0
"""Contraction certificate, and the correction of the valve current that enforces it.

Guarantees and limits: safety.md. The decision is computed in C, `firmware/hydro/loop_filter.h`. Stages: `model` (the
loop's record for it), `metric` (M), `controller` (the filter), `training` (`learn_metric`), `nodes`
(executables).
"""

from pathlib import Path

import hydro_bridge
import hydro_core
import hydro_sim
from hydro_sim.compiled import remove_stale_caches

remove_stale_caches(
    Path(__file__).parent, *(Path(str(used.__file__)).parent for used in (hydro_core, hydro_bridge, hydro_sim))
)
