# SPDX-License-Identifier: Apache-2.0
"""Effects of the load: the spring's stiffness and hardening, lost motion, rest position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_diagnosis.effects.base import (
    LOAD,
    MOTION,
    Effect,
    FitParameter,
    FloatArray,
    Kinematics,
    Memory,
    Values,
    changed,
)
from hydro_sim.model.bench import Bench


class _Load(Effect):
    equations = ("load",)
    family = "spring"
    blocks = frozenset({MOTION, LOAD})


class SpringStiffness(_Load):
    """k_s times a ratio."""

    id = "spring_stiffness"
    parameters = (
        FitParameter(name="ratio", unit="-", low=0.05, high=20.0, neutral=1.0, probes=(0.95,), smallest=0.002),
    )

    def bench(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, spring_stiffness=bench.spring_stiffness * values["ratio"])

    def sentence(self, values: Values) -> str:
        return f"The spring is {values['ratio']:.4g} times as stiff as the bench file says."


class SpringHardening(_Load):
    """f_l + k_3 (x_p - x_rest)^3."""

    id = "spring_hardening"
    parameters = (FitParameter(name="coefficient", unit="N/m3", low=-1e10, high=1e10, probes=(5e6,), smallest=1e5),)

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory,
             values: Values) -> FloatArray:  # fmt: skip
        deflection = motion.position - bench.spring_rest_position
        return force + values["coefficient"] * deflection * deflection * deflection

    def sentence(self, values: Values) -> str:
        change = "hardens" if values["coefficient"] > 0 else "softens"
        return f"The spring {change} with its deflection: {values['coefficient']:.3g} N/m3 times its cube."


class Backlash(_Load):
    """Lost motion: the spring carries no force within width/2 of its rest position."""

    id = "backlash"
    parameters = (FitParameter(name="width", unit="m", low=0.0, high=0.02, probes=(1e-4, 5e-4, 2e-3), smallest=1e-5),)

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory,
             values: Values) -> FloatArray:  # fmt: skip
        half = values["width"] / 2.0
        return force - bench.spring_stiffness * np.clip(motion.position - bench.spring_rest_position, -half, half)

    def sentence(self, values: Values) -> str:
        return f"The load has {values['width'] * 1e3:.3g} mm of lost motion around the spring's rest position."


class BacklashPlay(Backlash):
    """Lost motion wherever the direction changes: the spring is dragged through a gap of that width."""

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory,
             values: Values) -> FloatArray:  # fmt: skip
        dragged = memory.play("backlash", motion.position, values["width"])
        return force - bench.spring_stiffness * (motion.position - dragged)

    def sentence(self, values: Values) -> str:
        return f"The load has {values['width'] * 1e3:.3g} mm of lost motion whenever the direction changes."


class SpringRest(_Load):
    """The true rest position."""

    id = "spring_rest"

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        probe = self.reference + 1e-3
        return (
            FitParameter(
                name="position", unit="m", low=-5.0, high=5.0, neutral=self.reference, probes=(probe,), smallest=2e-5
            ),
        )

    def adapted(self, bench: Bench) -> Effect:
        return replace(self, reference=bench.spring_rest_position)

    def bench(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, spring_rest_position=values["position"])

    def sentence(self, values: Values) -> str:
        return f"The spring rests at {values['position'] * 1e3:.5g} mm, not where the bench file says."


EFFECTS: tuple[Effect, ...] = (
    SpringStiffness(),
    SpringHardening(),
    Backlash(),
    BacklashPlay({"form": "play"}),
    SpringRest(),
)
