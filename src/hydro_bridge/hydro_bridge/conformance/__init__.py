# SPDX-License-Identifier: Apache-2.0
"""Conformance test of a box against protocol.md, over the serial line.

`command` is the executable, which runs the test cases of `cases.yaml`; `host` is the line, the steps that cases consist
of, and what came; `checks` evaluates that, by the definitions in `reference`.
"""
