# SPDX-License-Identifier: Apache-2.0
"""Training of the metric: rollouts and labels, LMI refinement, thresholds, empirical certificate, command.

May import all of this package but `nodes`.
"""
