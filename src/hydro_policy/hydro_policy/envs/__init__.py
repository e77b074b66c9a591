# SPDX-License-Identifier: Apache-2.0
"""The task on many benches in parallel: vectorised box, plant and filter, domain randomisation.

May import `task` and `sac`'s acting policy.
"""
