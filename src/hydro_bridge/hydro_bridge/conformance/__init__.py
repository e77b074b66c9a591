# SPDX-License-Identifier: Apache-2.0
"""Whether a box keeps protocol.md, tried over its line.

`cases.yaml` says what is tried; `script` reads it; `host` speaks to the box; `checks` judges what came; `waveforms` and
`law` are the definitions it is judged by; `conversation`, `steps` and `damage` are what is sent; `run` carries the
cases out and `command` is the executable.
"""
