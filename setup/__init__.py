# SPDX-License-Identifier: Apache-2.0
"""Set-up of a fresh machine, standard library only: `python3 -m setup.bootstrap` (what `make setup` calls).

`plan` orders the steps, `host` looks at the machine, `venv` makes the environment and fills it by uv, `wheels` adapts
the ROS wheels to it, `workspace` builds the packages, `kernels` has the numerical kernels compiled (`compile_kernels`,
in the environment), `stamp` tells what is already done, `progress` runs and reports the steps, `layout` says where
things are. `ros2` is the stand-in command, copied into the environment.
"""
