# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic over the two gains of the force law, in simulation and on the bench.

Packages: `task` (the Markov decision process), `sac` (the algorithm), `envs` (vectorised benches), `supervision`
(arming, safety monitor, rollback, override), `runs` (files), `learner_process`, `evaluation`, `pretraining`,
`training_plan`, `nodes` (executables).
"""

from pathlib import Path

import hydro_bridge
import hydro_core
import hydro_filter
import hydro_sim
from hydro_sim.compiled import remove_stale_caches

remove_stale_caches(
    *(
        Path(file).parent
        for file in (__file__, hydro_core.__file__, hydro_bridge.__file__, hydro_filter.__file__, hydro_sim.__file__)
    )
)
