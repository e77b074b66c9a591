# SPDX-License-Identifier: Apache-2.0
"""Supervision of plant and policy during a session: arming, requirements, safety monitor, override."""
