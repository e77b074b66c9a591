# SPDX-License-Identifier: Apache-2.0
"""The learned bench as `Dynamics`: exact A, B in continuous time and A_d, B_d of its own sample, one state or a batch.

**What x is.** The eight measured states. The structured model has three more that no sensor shows: the spool, its rate
and the friction's bristle. They are held at an estimate in every derivative by x. Spool and bristle are driven by what
is known, the valve's current and the velocity, and forget where they began within some milliseconds: `observe` follows
them sample by sample; without it they are where current and velocity, held, would lead them (`steady`).

**Sampled** (`transition`): x a sample later under a held current, as the box shows it, its differentiation included.
A_d and B_d are the derivatives of that very map, by forward differentiation through the integrator. This is the exact
form. `transition_full` is the same for the augmented state of 12 (`model_kernels`), in which nothing is estimated.

**Continuous** (`linearize`): x' = f(x, u), with the spool where the current holds it, because a second-order spool
leaves no first-order effect of the current (B would be zero). Row by row::

    f_h'   = A_p (p_a' - alpha p_b')                   f_l'  = the state f_l'
    f_h''  = (f_h' - the state f_h') / age             f_l'' = of the load cell's amplifier
    p_a', p_b', x_p''  of the physics; x_p' = the state x_p'

f_h'' is that of the box's differentiator, whose lag is its age. Nothing depends on the state f_h: the pressures say
more.

The paper's network has no hidden states: x' is its output, and its sample is one Euler step, so A_d = I + T A.
"""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_filter import hidden_states, model_kernels, network_kernels
from hydro_filter.dynamics import Linearization, Transition
from hydro_filter.hidden_states import HIDDEN
from hydro_filter.state import STATES
from hydro_sim.learned.model import Model
from hydro_sim.learned.network_model import NetworkModel
from hydro_sim.learned.structured import FULL
from hydro_sim.learned.structured_model import StructuredModel
from hydro_sim.sensors import Sensors


class StructuredDynamics:
    """The structured model (module docstring).

    Parameters
    ----------
    model
        With its constants, network and normalization.
    sensors
        How the box differentiates.
    """

    def __init__(self, model: StructuredModel, sensors: Sensors | None = None) -> None:
        self.compiled = model.compiled
        self.ages = np.array([(sensors or Sensors()).force_rate_age])
        self.hidden: FloatArray | None = None
        """Spool [A], its rate [A/s], bristle [m], shape (3,), as followed; None: steady ones."""

    def forget(self) -> None:
        """Take hidden states as steady until the next `observe`."""
        self.hidden = None

    def observe(self, state: FloatArray, current: float) -> None:
        """Follow the hidden states over the sample that begins at x, shape (8,), with the valve's current [A]."""
        if self.hidden is None:
            self.hidden = self.hidden_at(state[np.newaxis], np.array([current]))[0]
        hidden_states.follow(self.compiled[0], state[7], current, self.hidden)

    def linearize(self, state: FloatArray, current: float) -> Linearization:
        """A, B and x' at state x, shape (8,), and valve current [A]."""
        linear = Linearization(np.empty((STATES, STATES)), np.empty(STATES), np.empty(STATES))
        bristle = self._hidden(state, current)[hidden_states.BRISTLE_STATE]
        model_kernels.flow(self.compiled, self.ages, state, bristle, current, *linear)
        return linear

    def transition(self, state: FloatArray, current: float) -> Transition:
        """A_d, B_d and x a sample later, from state x, shape (8,), under a held current [A]."""
        step = Transition(np.empty((STATES, STATES)), np.empty(STATES), np.empty(STATES))
        model_kernels.transition(self.compiled, state, self._hidden(state, current), current, *step)
        return step

    def transition_full(self, full: FloatArray, current: float) -> Transition:
        """A_d (12, 12), B_d (12,) and the full state a sample later, of the full state, shape (12,)."""
        step = Transition(np.empty((FULL, FULL)), np.empty(FULL), np.empty(FULL))
        model_kernels.transition_full(self.compiled, full, current, *step)
        return step

    def hidden_at(self, states: FloatArray, currents: FloatArray) -> FloatArray:
        """Hidden states, shape (n, 3), to which states, shape (n, 8), and currents, shape (n,), lead if held."""
        hidden = np.empty((len(states), HIDDEN))
        for k in range(len(states)):
            hidden_states.steady(self.compiled[0], states[k, 7], currents[k], hidden[k])
        return hidden

    def linearize_batch(
        self, states: FloatArray, currents: FloatArray, hidden: FloatArray | None = None
    ) -> Linearization:
        """A (n, 8, 8), B (n, 8), x' (n, 8) at states (n, 8), currents (n,) and hidden states (n, 3); None: steady."""
        hidden = self.hidden_at(states, currents) if hidden is None else hidden
        linear = Linearization(*_empty(len(states), STATES))
        bristles = np.ascontiguousarray(hidden[:, hidden_states.BRISTLE_STATE])
        model_kernels.flows(*self.compiled, self.ages, states, bristles, currents, *linear)
        return linear

    def transition_batch(
        self, states: FloatArray, currents: FloatArray, hidden: FloatArray | None = None
    ) -> Transition:
        """A_d (n, 8, 8), B_d (n, 8) and x a sample later (n, 8); arguments as of `linearize_batch`."""
        hidden = self.hidden_at(states, currents) if hidden is None else hidden
        step = Transition(*_empty(len(states), STATES))
        model_kernels.transitions(*self.compiled, states, hidden, currents, *step)
        return step

    def transition_full_batch(self, full: FloatArray, currents: FloatArray) -> Transition:
        """A_d (n, 12, 12), B_d (n, 12) and full states a sample later (n, 12), from full states (n, 12)."""
        step = Transition(*_empty(len(full), FULL))
        model_kernels.transitions_full(*self.compiled, full, currents, *step)
        return step

    def _hidden(self, state: FloatArray, current: float) -> FloatArray:
        if self.hidden is not None:
            return self.hidden
        return self.hidden_at(state[np.newaxis], np.array([current]))[0]


class NetworkDynamics:
    """The paper's network, in float64 with the float32 weights that the plant runs by."""

    def __init__(self, model: NetworkModel) -> None:
        layers, _ = model.compiled
        wide = type(layers)(*(part.astype(np.float64) for part in layers))
        self.compiled = (wide, model.center, model.scale, model.current_scale, model.rate_scale)

    def linearize(self, state: FloatArray, current: float) -> Linearization:
        """A, B and x' at state x, shape (8,), and valve current [A]."""
        linear = Linearization(np.empty((STATES, STATES)), np.empty(STATES), np.empty(STATES))
        network_kernels.flow(self.compiled, state, current, *linear)
        return linear

    def transition(self, state: FloatArray, current: float) -> Transition:
        """A_d, B_d and x a sample later, from state x, shape (8,), under a held current [A]."""
        step = Transition(np.empty((STATES, STATES)), np.empty(STATES), np.empty(STATES))
        network_kernels.transition(self.compiled, state, current, *step)
        return step

    def linearize_batch(self, states: FloatArray, currents: FloatArray) -> Linearization:
        """A (n, 8, 8), B (n, 8), x' (n, 8) at states (n, 8) and currents (n,)."""
        linear = Linearization(*_empty(len(states), STATES))
        network_kernels.flows(*self.compiled, states, currents, *linear)
        return linear

    def transition_batch(self, states: FloatArray, currents: FloatArray) -> Transition:
        """A_d (n, 8, 8), B_d (n, 8) and x a sample later (n, 8)."""
        step = Transition(*_empty(len(states), STATES))
        network_kernels.transitions(*self.compiled, states, currents, *step)
        return step


def model_dynamics(model: Model) -> StructuredDynamics | NetworkDynamics:
    """The `Dynamics` of a learned model, for instance of `hydro_sim.learned.model.Learned.load().model`.

    Raises
    ------
    ValueError
        The model is neither structured nor a network alone of two layers: nobody has written its derivatives.
    """
    if isinstance(model, NetworkModel):
        return NetworkDynamics(model)
    if not isinstance(model, StructuredModel):
        raise ValueError(f"a {model.name} model has no derivatives here: structured ones and two-layer networks have")
    return StructuredDynamics(model)


def _empty(count: int, states: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    return np.empty((count, states, states)), np.empty((count, states)), np.empty((count, states))
