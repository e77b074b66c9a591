# SPDX-License-Identifier: Apache-2.0
"""Model of the bench, software of the box, and their simulation. Only `nodes` uses ROS.

Stages: `model` (textbook equations, effects, sensors), `box` (the software of the MicroLabBox), `simulation` (both
together); `excitation`, `files`, `identification` (a bench learnt from recordings), `export` (to other programs);
`emulator` (a MicroLabBox behind a pseudo-terminal, with a truth plant of its own); `nodes` (executables).
"""
