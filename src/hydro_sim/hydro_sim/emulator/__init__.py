# SPDX-License-Identifier: Apache-2.0
"""The emulator: a MicroLabBox with a truth plant independent of the simulated one, on a pseudo-terminal or offline.

`truth` is the plant, `line` the serial line; `machine` adds the box; `offline` records it fast; `realtime`
runs it on the line; `command` is the executable.
"""
