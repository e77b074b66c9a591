# SPDX-License-Identifier: Apache-2.0
"""What may go to the valve: commands finite, clamped and fresh, what must be there before arming, what the box is.

May import `signals`, `files` and the frames of `serial`; plant nodes and simulations send nothing past it.
"""
