# SPDX-License-Identifier: Apache-2.0
"""The effects of a diagnosis' corrected.yaml as parts of the analytic plant, compiled.

::

    corrected.yaml ── catalogue: which form, are its numbers in range ── program: one record for compiled code
                                                                            |
    current ─ valve: delay, spool, overlap ─ edges ─ oil: supply, leaks, stiffness ─ motion: friction, load ─ sensing

`integration` puts them together; `model.plant.AnalyticPlant` runs it for a bench that has effects. Definitions are
those of the diagnosis' library (physics.md, "Effects"); the code is not, and the emulator's neither.
"""
