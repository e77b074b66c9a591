# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic over the two gains of the force law, in simulation and on the bench.

Packages: `task` (the Markov decision process), `sac` (the algorithm), `envs` (vectorised benches), `supervision`
(arming, safety monitor, rollback, override), `runs` (files), `learner_process`, `evaluation`, `pretraining`,
`training_plan`, `nodes` (executables).
"""
