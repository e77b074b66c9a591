# SPDX-License-Identifier: Apache-2.0
"""Conformance test of a box against protocol.md, over the serial line.

`command` is the executable, which runs the test cases of `cases.yaml`; `host` is a session on the line, with the
handlers of the steps; `checks` evaluates the received states, by the definitions in `reference`.
"""
