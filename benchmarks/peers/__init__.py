# SPDX-License-Identifier: Apache-2.0
"""Other ways to find what a simulation lacks, set up on the recordings of the proof as well as we know how.

`terms`: a library of candidate terms that holds the true ones; `sindy`, `sindy_worker`: PySINDy on it, weak form;
`neural`: a free-form residual; `plain`: the bench file's numbers fitted by forward simulation; `run`: a recording as
all of them see it, and the held-out error, which is the diagnosis' own.
"""
