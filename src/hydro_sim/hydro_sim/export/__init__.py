# SPDX-License-Identifier: Apache-2.0
"""The bench for other programs: FMU, MuJoCo, Simulink, C."""
