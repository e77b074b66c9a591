# SPDX-License-Identifier: Apache-2.0
"""The proof on sealed cases: benches with concealed causes, diagnosed blind, scored once the seal is opened.

`magnitudes`, `cases`: what is concealed; `seal`: the answers, digest first; `recording`, `bench_graph`: the emulator as
a process; `access_guard`, `blind`: the diagnosis in a process that sees recordings and bench.yaml alone; `oracle_fit`:
the fit of the true structure, after opening; `names`, `facts`, `standards`: scores; `pictures`, `page`: what is shown.
`prove` puts them together. proof.md.
"""
