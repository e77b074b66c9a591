# SPDX-License-Identifier: Apache-2.0
"""Blind benchmark on sealed cases: concealed causes are diagnosed blind and scored once the seal is opened.

`cases`: concealed causes; `recording`: the emulator as a process; `blind`: the diagnosis in a process that sees
recordings and bench.yaml alone; `scores`, `pictures`: results. `prove` runs all stages; see proof.md.
"""
