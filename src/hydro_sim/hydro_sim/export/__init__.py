# SPDX-License-Identifier: Apache-2.0
"""Export of a bench to other programs: FMU, MuJoCo, Simulink, C."""
