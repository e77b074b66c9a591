# SPDX-License-Identifier: Apache-2.0
"""What watches a plant and a policy while a session runs: arming, requirements, safety monitor, rollback, override.

May import `task` and `sac`.
"""
