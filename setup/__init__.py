# SPDX-License-Identifier: Apache-2.0
"""Set-up of a fresh machine, standard library only: `python3 -m setup.bootstrap` (what `make setup` calls).

`steps` orders the steps and tells which are needed, `environment` looks at the machine and fills `.venv`; `kernels`,
which runs in it, lists what is compiled. `ros2` is the stand-in command, copied into `.venv`.
"""
