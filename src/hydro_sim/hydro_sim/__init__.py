# SPDX-License-Identifier: Apache-2.0
"""The bench as a model, and what runs in its box. No module here but those under `nodes` knows ROS.

`bench` says what the bench is believed to be, `hydraulics` its equations, `sensors` how it is measured, `plant` a bench
to step; `reference`, `force_law` and `box` are what the MicroLabBox runs; `offline` puts a plant and a box together
without a graph; `plotting` draws what came out; `emulator` is a MicroLabBox behind a pseudo-terminal.
"""

from pathlib import Path

import hydro_bridge
from hydro_sim.compilations import record_compilations
from hydro_sim.compiled import forget_stale

record_compilations()
forget_stale(*(Path(file).parent for file in (__file__, hydro_bridge.__file__)))
