# SPDX-License-Identifier: Apache-2.0
"""The story end to end, `make demo`: pretrain, meet the bench, record, diagnose, correct, retrain, meet it again.

`stages` calls the executables, one function a stage; `trial` puts controllers on the emulated bench and on what a
simulation takes for it; `page` draws the outcome; `__main__` is the story. It imports from both sides of the diagnosis,
as no package may.
"""
