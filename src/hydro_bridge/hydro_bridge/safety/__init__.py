# SPDX-License-Identifier: Apache-2.0
"""Safety of commands: lease, guard, limits, readiness before arming, the box's identity."""
