# SPDX-License-Identifier: Apache-2.0
"""The contraction certificate and the correction of the valve current that keeps it.

What it can and cannot do: docs/safety.md.

`state` has the state's layout and units, `sample` what is read of it; `dynamics`, `controller` and `metric` each hold
a protocol and its analytic form; `certificate` puts them together to a half-line, `qp` finds the smallest correction
on it, `filter` is the whole, one sample in and one correction out; `nodes` moves messages. Models and their exact
derivatives are compiled in `analytic_kernels`, `model_kernels`, `tangent*` and `hidden_states`.

The learned filter: `loop_model` and `displacement` have the whole force loop, `metric_network` and `learned_metric` the
metric, `sampled_certificate` and `loop_decision` one decision, `loop_filter` the whole; `learn_metric` trains
(`metric_*`), `validate` tries (`validation*`), `choice` says which filter runs.
"""

from pathlib import Path

import hydro_bridge
import hydro_sim
from hydro_sim.compiled import forget_stale

forget_stale(*(Path(file).parent for file in (__file__, hydro_bridge.__file__, hydro_sim.__file__)))
