# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic over the two gains of the force law: the task, the algorithm, the learner process, the run's files.

The mathematics: `task` (observation, reward, gains), `mlp` and `sac` (networks, algorithm), `replay`, `actor` (numpy inference).
The machinery: `episode` (steps and transitions from a stream of samples), `shared` (memory between acting and learning),
`learner` (the learning process and its supervision), `checkpoint` and `run` (files), `scoring` (force RMSE tables).
The ROS side is under `nodes`.
"""
