# SPDX-License-Identifier: Apache-2.0
"""Effects beyond the textbook equations: one class each, in the module of the component that causes it.

`base` defines the parts of an effect, `catalogue` finds one by an entry of the bench file. Parameters and meanings are
those of the diagnosis (physics.md, "Effects"); the emulator's truth has forms of its own.
"""
