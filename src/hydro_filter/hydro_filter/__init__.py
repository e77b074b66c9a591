# SPDX-License-Identifier: Apache-2.0
"""Contraction certificate, and the correction of the valve current that enforces it.

Guarantees and limits: filter.md. The decision is computed in C, `firmware/hydro/loop_filter.h`. Stages: `model` (the
loop's record for it), `metric` (M), `controller` (the filter), `training` (`learn_metric`), `nodes`
(executables).
"""
