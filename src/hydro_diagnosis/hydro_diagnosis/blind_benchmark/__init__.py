# SPDX-License-Identifier: Apache-2.0
"""Blind benchmark on sealed cases: concealed causes are diagnosed blind and scored once the seal is opened.

`magnitudes`, `cases`: concealed causes; `seal`: the answers, digest first; `recording`, `bench_graph`: the emulator as
a process; `access_guard`, `blind`: the diagnosis in a process that sees recordings and bench.yaml alone; `oracle_fit`:
the fit of the true structure, after opening; `names`, `facts`, `standards`: scores; `pictures`, `page`: results.
`prove` runs all stages; see proof.md.
"""
