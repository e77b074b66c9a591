# SPDX-License-Identifier: Apache-2.0
"""Effects of the load: the spring's stiffness and hardening, lost motion, rest position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_diagnosis.effects.base import LOAD, MOTION, Effect, FitParameter, FloatArray, Kinematics, Values
from hydro_diagnosis.effects.bench_values import RATIO, TrueValue, times
from hydro_diagnosis.effects.memory import Memory
from hydro_sim.model.bench import Bench


class _Load(Effect):
    equations = ("load",)
    family = "spring"
    blocks = frozenset({MOTION, LOAD})


class SpringHardening(_Load):
    """f_l + k_3 (x_p - x_rest)^3."""

    id = "spring_hardening"
    parameters = (FitParameter(name="coefficient", unit="N/m3", low=-1e10, high=1e10, probes=(5e6,), smallest=1e5),)

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: Values) -> FloatArray:
        deflection = motion.position - bench.spring_rest_position
        return force + values["coefficient"] * deflection * deflection * deflection

    def sentence(self, values: Values) -> str:
        change = "hardens" if values["coefficient"] > 0 else "softens"
        return f"The spring {change} with its deflection: {values['coefficient']:.3g} N/m3 times its cube."


class Backlash(_Load):
    """Lost motion: the spring carries no force within width/2 of its rest position."""

    id = "backlash"
    says = "The load has {width:.3g} mm of lost motion around the spring's rest position."
    parameters = (FitParameter(name="width", unit="m", low=0.0, high=0.02, probes=(1e-4, 5e-4, 2e-3), smallest=1e-5),)

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: Values) -> FloatArray:
        half = values["width"] / 2.0
        return force - bench.spring_stiffness * np.clip(motion.position - bench.spring_rest_position, -half, half)


class BacklashPlay(Backlash):
    """Lost motion wherever the direction changes: the spring is dragged through a gap of that width."""

    says = "The load has {width:.3g} mm of lost motion whenever the direction changes."

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: Values) -> FloatArray:
        dragged = memory.play("backlash", motion.position, values["width"])
        return force - bench.spring_stiffness * (motion.position - dragged)


class SpringRest(TrueValue):
    """The true rest position."""

    id = "spring_rest"
    says = "The spring rests at {position:.5g} mm, not where the bench file says."
    refers = "spring_rest_position"
    equations, family, blocks = _Load.equations, _Load.family, _Load.blocks
    number = FitParameter(name="position", unit="m", low=-5.0, high=5.0, probes=(1e-3,), smallest=2e-5)


_RATIO = replace(RATIO, low=0.05, high=20.0, smallest=0.002)
EFFECTS: tuple[Effect, ...] = (
    times("spring_stiffness", "spring", "load", _Load.blocks, ratio=_RATIO, family=_Load.family,
          says="The spring is {ratio:.4g} times as stiff as the bench file says."),
    SpringHardening(),
    Backlash(),
    BacklashPlay({"form": "play"}),
    SpringRest(),
)  # fmt: skip
