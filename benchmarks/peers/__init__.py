# SPDX-License-Identifier: Apache-2.0
"""Other ways to find what a simulation lacks, set up on the recordings of the proof as well as we know how.

`terms`: a library of candidate terms that holds the true ones; `sindy`, `sindy_worker`: PySINDy on it, weak form;
`run`: a recording as all of them
see it, and the held-out error, which is the diagnosis' own.
"""

from __future__ import annotations

from pathlib import Path

import hydro_sim
from hydro_sim.compiled import remove_stale_caches

remove_stale_caches(Path(__file__).parent, Path(hydro_sim.__file__).parent)
