# SPDX-License-Identifier: Apache-2.0
"""Building, specimen and actuator of the benchmark: numbers, perturbations and equations.

A building of three floors is split. Its numerical substructure is simulated, its specimen, mass, damper and spring at
floor 1, is moved by a servo-hydraulic actuator that shall follow the displacement x_n1 of the simulated floor::

    M_N x_n'' + C_N x_n' + K_N x_n = -M 1 a_g - (f_e, 0, 0)                            M_N = M - M_E, ...
    q'' + beta_1 q' + beta_2 q = a1_beta0 (gain u - x)                                 servo valve, u: command [m]
    f' + a_3 f = q - a_2 x'                                                            actuator's force
    m_e x'' + c_e x' + alpha k_e x + f_h = f                                           specimen, f within its limit
    f_h' = (1 - alpha) k_e (1 - |f_h / f_y|^n (n_1 sign(f_h x') + 1 - n_1)) x'         Bouc-Wen; linear: alpha = 1
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_core.signals import FloatArray
from hydro_sim.jit import njit

STIFFNESS = np.array([
    [26054883.879603837, -23133938.877108198, 5937035.463339146],
    [-23133938.877108198, 32560774.186380334, -14419970.777236981],
    [5937035.463339146, -14419970.777236985, 9267275.506224312],
])  # fmt: skip
"""K [N/m] of all buildings."""
MASS = {1: 1000.0, 2: 1100.0, 3: 1300.0, 4: 1000.0}
"""Of each floor of a building [kg]."""
DAMPING = {
    1: (14084.275745299876, -7873.031460913151, 440.4514988426247, 14943.622937895665, -6348.672096305331,
        7223.101316804461),
    2: (11817.42262041908, -6606.215423308698, 369.6755622296918, 12538.57756973086, -5327.047373791856,
        6060.319809850064),
    3: (9635.014363361863, -5386.025774196529, 301.43864014406876, 10223.006811768844, -4343.084702116766,
        4941.298824869293),
    4: (8450.565447179924, -4723.818876547891, 264.27089930557526, 8966.173762737399, -3809.203257783199,
        4333.8607900826755),
}  # fmt: skip
"""Upper triangle of the damping matrix [N s/m]: 5, 4, 3 and 3 % in each mode."""
FLOORS = 3
SPECIMENS = ("linear", "yielding")
X, V, VALVE, VALVE_RATE, FORCE, POSITION, VELOCITY, HYSTERESIS, STATES = 0, 3, 6, 7, 8, 9, 10, 11, 12
"""Places in the state: x_n, x_n' (three each), q, q', f, x, x', f_h, and their number."""


class Structure(NamedTuple):
    """Floors of a building: x'' = -damping x' - stiffness x - influence a_g - share f, f the specimen's force."""

    damping: FloatArray
    """1/s, shape (3, 3)."""
    stiffness: FloatArray
    """1/s^2, shape (3, 3)."""
    influence: FloatArray
    """Of the ground's acceleration, shape (3,)."""
    share: FloatArray
    """Of the force at floor 1 [1/kg], shape (3,)."""


class Specimen(NamedTuple):
    """Experimental substructure."""

    mass: float = 29.13
    """kg."""
    damping: float = 2.0 * 0.0097 * float(np.sqrt(1.19e6 * 29.13))
    """N s/m."""
    stiffness: float = 1.19e6
    """N/m, before it yields."""
    after_yield: float = 1.0
    """alpha, share of the stiffness that is left; 1: it does not yield."""
    yield_force: float = 1.0
    """N."""
    smoothness: float = 2.5
    """n."""
    shape: float = 0.1
    """n_1."""


class Actuator(NamedTuple):
    """Servo valve and actuator, with the servo loop of the displacement."""

    a3: float = 3.3
    """1/s."""
    beta1: float = 425.0
    """1/s."""
    beta2: float = 99976.0
    """1/s^2."""
    gain: float = 1.0261
    a1_beta0: float = 2.1283e13
    a2: float = 4.2297e6
    """N/m."""
    limit: float = 8900.0
    """N."""


YIELDING = Specimen(29.1, 114.6, 1.19e6, 0.1, 0.9 * 1.19e6 * 1e-3)
"""The specimen of FermandoisLab/RobustAMBCvRTHS, 2. AMB_NonLinear; it yields at 1 mm."""


def drawn(seed: int, count: int) -> list[tuple[Actuator, Specimen]]:
    """Return the nominal plant and `count` perturbed ones: a_3, beta_1, beta_2 and k_e are normal, in that order."""
    plants = [(Actuator(), Specimen())]
    deviations = (1.3, 3.3, 3.3e3, 5e4)
    for change in np.random.default_rng(seed).standard_normal((count, 4)) * deviations:
        stiffness = 1.19e6 + float(change[3])
        damping = 2.0 * 0.0097 * float(np.sqrt(stiffness * 29.13))
        actuator = Actuator(3.3 + float(change[0]), 425.0 + float(change[1]), 99976.0 + float(change[2]))
        plants.append((actuator, Specimen(damping=damping, stiffness=stiffness)))
    return plants


def building(number: int) -> tuple[FloatArray, FloatArray]:
    """Return the mass [kg] and damping [N s/m] matrices of a building, shape (3, 3)."""
    c11, c12, c13, c22, c23, c33 = DAMPING[number]
    return MASS[number] * np.eye(FLOORS), np.array([[c11, c12, c13], [c12, c22, c23], [c13, c23, c33]])


def reference_structure(number: int, specimen: Specimen) -> Structure:
    """Whole building, except the spring of its specimen."""
    mass, damping = building(number)
    spring = np.zeros((FLOORS, FLOORS))
    spring[0, 0] = specimen.stiffness
    inverse = np.linalg.inv(mass)
    return Structure(inverse @ damping, inverse @ (STIFFNESS - spring), np.ones(FLOORS), inverse[:, 0].copy())


def numerical_substructure(number: int, specimen: Specimen) -> Structure:
    """Building without its specimen."""
    mass, damping = building(number)
    corner = np.zeros((FLOORS, FLOORS))
    corner[0, 0] = 1.0
    inverse = np.linalg.inv(mass - specimen.mass * corner)
    return Structure(
        inverse @ (damping - specimen.damping * corner), inverse @ (STIFFNESS - specimen.stiffness * corner),
        inverse @ mass @ np.ones(FLOORS), inverse[:, 0].copy(),
    )  # fmt: skip


def transfer_function(actuator: Actuator, specimen: Specimen) -> tuple[float, FloatArray]:
    """Numerator and denominator, s^5 first, from the command to the displacement of a linear specimen."""
    m, c, k = specimen.mass, specimen.damping, specimen.stiffness
    t1, t2, t3 = k * actuator.a3, k + c * actuator.a3 + actuator.a2, c + m * actuator.a3
    denominator = np.array([
        m, t3 + m * actuator.beta1, t2 + t3 * actuator.beta1 + m * actuator.beta2,
        t1 + t2 * actuator.beta1 + t3 * actuator.beta2, t1 * actuator.beta1 + t2 * actuator.beta2,
        t1 * actuator.beta2 + actuator.a1_beta0,
    ])  # fmt: skip
    return actuator.gain * actuator.a1_beta0, denominator


@njit
def floor_rates(structure, state, ground, force, rates):
    """Rates of x_n and x_n' under a ground acceleration [m/s^2] and a force at floor 1 [N]."""
    for i in range(FLOORS):
        rates[X + i] = state[V + i]
        total = -structure.influence[i] * ground - structure.share[i] * force
        for j in range(FLOORS):
            total -= structure.stiffness[i, j] * state[X + j] + structure.damping[i, j] * state[V + j]
        rates[V + i] = total


@njit
def hysteresis_rate(specimen, force, velocity):
    """f_h' [N/s]."""
    side = specimen.shape * np.sign(force * velocity) + 1.0 - specimen.shape
    left = 1.0 - abs(force / specimen.yield_force) ** specimen.smoothness * side
    return (1.0 - specimen.after_yield) * specimen.stiffness * left * velocity


@njit
def spring_force(specimen, position, hysteresis):
    """Force of the specimen's spring [N]."""
    return specimen.after_yield * specimen.stiffness * position + hysteresis


@njit
def acting_force(actuator, force):
    """Force of the actuator within its limit [N]."""
    return min(max(force, -actuator.limit), actuator.limit)


@njit
def plant_rates(actuator, specimen, state, command, rates):
    """Rates of valve, actuator and specimen under a command [m]."""
    force = acting_force(actuator, state[FORCE])
    position, velocity = state[POSITION], state[VELOCITY]
    rates[VALVE] = state[VALVE_RATE]
    rates[VALVE_RATE] = (
        actuator.a1_beta0 * (actuator.gain * command - position)
        - actuator.beta1 * state[VALVE_RATE] - actuator.beta2 * state[VALVE]
    )  # fmt: skip
    rates[FORCE] = state[VALVE] - actuator.a2 * velocity - actuator.a3 * state[FORCE]
    rates[POSITION] = velocity
    spring = spring_force(specimen, position, state[HYSTERESIS])
    rates[VELOCITY] = (force - specimen.damping * velocity - spring) / specimen.mass
    rates[HYSTERESIS] = hysteresis_rate(specimen, state[HYSTERESIS], velocity)
