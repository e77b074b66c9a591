# SPDX-License-Identifier: Apache-2.0
"""An emulated MicroLabBox: a truth plant unlike the simulated one, behind a pseudo-terminal or run offline.

`effects`, `outside`, `truth_config` say what the bench is; `oil`, `valve`, `friction`, `load`, `dynamics`, `sensing` are its
physics; `truth` steps it; `offline` makes recordings fast; `machine`, `terminal`, `faults`, `command` put it on a serial line.
"""
