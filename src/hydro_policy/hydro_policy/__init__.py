# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic over the two gains of the force law: the task, the algorithm, the learner process, the run's files.

Mathematics: `task` (observation, reward, gains), `mlp` and `sac` (networks, algorithm), `replay`, `policy` (acting).
Sessions: `steps` (samples to steps), `watch` (plant and arming), `training` and `episode`, `evaluation`, `controllers`,
`report`; `offline` runs them without a graph. Learning: `learner` (the process), `supervisor` (its handle), `shared`
(memory between the two). Files: `run`, `checkpoint`, `snapshot`. The ROS side is under `nodes`.
Pretraining: `fleet` (many benches, `fleet_plants`, `fleet_filter`, `fleet_runs`), `environment`, `randomisation`,
`pretraining`, `configurations`; `pretrain` is the command, `sac_kernel` the compiled updates.
"""

from pathlib import Path

import hydro_bridge
import hydro_filter
import hydro_sim
from hydro_sim.compiled import forget_stale

forget_stale(
    *(Path(file).parent for file in (__file__, hydro_bridge.__file__, hydro_filter.__file__, hydro_sim.__file__))
)
