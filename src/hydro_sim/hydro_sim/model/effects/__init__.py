# SPDX-License-Identifier: Apache-2.0
"""What a bench may do beyond the textbook: each effect one class, in the module of the part where its cause lives.

`base` says what an effect is made of, `catalogue` finds one by an entry of the bench file. Parameters and meanings are
those of the diagnosis (physics.md, "Effects"); the emulator's truth has forms of its own.
"""
