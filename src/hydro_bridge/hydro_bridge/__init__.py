# SPDX-License-Identifier: Apache-2.0
"""The outside world as topics and arrays: serial line, bags, terminal, and what goes to the valve.

`signals` names what travels. Stages: `serial` (bytes), `safety` (what may go down), `link` (the bridge's end of the
line), `bags` (recordings), `ros` (what all nodes share), `nodes` (executables). Beside them: `files`, `cli`, `process`.
"""
