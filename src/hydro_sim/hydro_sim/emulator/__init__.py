# SPDX-License-Identifier: Apache-2.0
"""An emulated MicroLabBox: a truth plant unlike the simulated one, behind a pseudo-terminal or run offline.

`effects`, `outside` and `truth_config` say what the bench is; `oil`, `valve`, `friction`, `load`, `dynamics` and
`sensing` are its physics, `truth` its steps; `machine` adds the box; `offline` records it fast; `terminal`, `faults`,
`link` and `realtime` put it on a serial line.
"""
