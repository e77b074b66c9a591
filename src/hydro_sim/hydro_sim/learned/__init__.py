# SPDX-License-Identifier: Apache-2.0
"""The bench as learned from recordings: x' = f(x, u), rolled out recursively (paper, section Hydraulic Model Learning).

`schedule` and `coverage` say what is recorded, `recordings` how it is split. Two structures: the paper's (`mlp`,
`network`, `network_model`), and physics with learned constants and a network for the rest (`physics`, `integration`,
`structured`, `constants`, `structured_model`) with its `observer`. `training` puts `identify`, `objectives` and `adam`
together; `evaluation` judges, beside `analytic`; `model` and `weights` are files, `region` is where a model was
trained, `plant` steps it. Commands: `learn`, `validate`, and `collect` under `nodes`.
"""
