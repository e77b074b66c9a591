# SPDX-License-Identifier: Apache-2.0
"""The outside world as topics and arrays.

`signals` names what travels, `protocol` frames it for the serial line, `port` keeps the line open, `guard` decides
what may go down, `clock` maps the box's time, `recording` reads and writes bags, `ros` holds what all nodes share,
`console` what all commands share; `nodes` are the executables `bridge`, `recorder` and `replayer`.
"""
