# SPDX-License-Identifier: Apache-2.0
"""The two rates of the graph (paper, section Real-World Training Implementation)."""

from __future__ import annotations

SAMPLE = 1e-3
"""s, one box sample: the current is held for it, the state is published after it."""

POLICY_SAMPLES = 10
"""Box samples per policy step: gains come at 100 Hz."""
