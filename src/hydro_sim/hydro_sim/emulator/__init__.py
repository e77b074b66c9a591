# SPDX-License-Identifier: Apache-2.0
"""An emulated MicroLabBox: a truth plant unlike the simulated one, behind a pseudo-terminal or run offline.

`truth` is the plant, `line` the serial line; `machine` adds the box; `offline` records it fast; `realtime` and
`control` run it on the line; `command` is the executable.
"""
