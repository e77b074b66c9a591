# SPDX-License-Identifier: Apache-2.0
"""Conformance test of a box against protocol.md, over the serial line.

`cases.yaml` lists the test cases and `script` reads it; `host` communicates with the box; `checks` evaluates its
answers; `waveforms` and `law` are the reference definitions; `conversation`, `steps` and `damage` generate what is
sent; `run` executes the cases and `command` is the executable.
"""
