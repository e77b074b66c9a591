# SPDX-License-Identifier: Apache-2.0
"""Model of a bench, from its file: equations, effects, sensors, and a plant to step.

May import nothing else of this package; all else depends on it.
"""
