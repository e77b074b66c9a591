# SPDX-License-Identifier: Apache-2.0
"""Conformance test of a box against protocol.md, over the serial line.

`cases` reads and runs the test cases of `cases.yaml`; `conversation` holds the steps that they consist of; `host`
is the line and what came over it; `checks` evaluates that, by the definitions in `reference`; `command` is the
executable.
"""
