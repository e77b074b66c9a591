# SPDX-License-Identifier: Apache-2.0
"""A boom on a hinge, moved by the bench's cylinder in MuJoCo.

ros2 run hydro_sim export --mujoco cylinder.py --bench corrected.yaml
python docs/examples/cylinder_on_a_hinge.py cylinder.py

The boom's mass is the bench's moving mass, and a spring along the cylinder is the bench's, so that this scene does what
the bench does. Leave the spring out, and give the boom a mass and an inertia, for a machine of your own.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np

HINGE_TO_EYE, LENGTH = 1.0, 0.5
"""m: height of the cylinder's eye above the hinge, and length of the cylinder where the bench's spring is relaxed."""
SCENE = f"""<mujoco model="boom">
  <option timestep="{{timestep}}" gravity="0 0 0"/>
  <worldbody>
    <site name="anchor" pos="{-LENGTH} 0 {HINGE_TO_EYE}"/>
    <body name="boom">
      <joint name="hinge" axis="0 1 0"/>
      <geom type="sphere" size="0.02" pos="0 0 {HINGE_TO_EYE}" mass="{{mass}}"/>
      <site name="eye" pos="0 0 {HINGE_TO_EYE}"/>
    </body>
  </worldbody>
  <tendon>
    <spatial name="rod" stiffness="{{stiffness}}" springlength="{LENGTH}" solreffriction="{{softness}} 1">
      <site site="anchor"/><site site="eye"/>
    </spatial>
  </tendon>
  <actuator><motor name="cylinder" tendon="rod"/></actuator>
</mujoco>"""


def load(file: Path) -> ModuleType:
    """Import the module that `export --mujoco` has written."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def simulate(exported: ModuleType, currents: np.ndarray, timestep: float = 1e-3) -> np.ndarray:
    """Readings f_h [N], -, p_a, p_b [Pa], x_p [m] after each millisecond at these valve currents [A], shape (n, 5)."""
    number = exported.PARAMETERS
    scene = SCENE.format(
        timestep=timestep, mass=number["bench.moving_mass"], stiffness=number["bench.spring_stiffness"],
        softness=2.0 * timestep,
    )  # fmt: skip
    model = mujoco.MjModel.from_xml_string(scene)
    data = mujoco.MjData(model)
    cylinder = exported.Cylinder(model, "cylinder", retracted=LENGTH - number["bench.spring_rest_position"])
    readings = np.empty((len(currents), 5))
    for k, current in enumerate(currents):
        for _ in range(round(1e-3 / timestep)):
            mujoco.mj_step1(model, data)
            cylinder.step(data, current)
            mujoco.mj_step2(model, data)
        readings[k] = cylinder.readings
    return readings


if __name__ == "__main__":
    time = np.arange(2000) * 1e-3
    for k, row in enumerate(simulate(load(Path(sys.argv[1])), 2e-3 * np.sin(2.0 * np.pi * time))):
        if k % 100 == 0:
            print(f"{time[k]:.1f} s: {row[0]:8.1f} N at {1e3 * row[4]:6.2f} mm")
