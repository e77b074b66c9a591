# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic (Haarnoja et al. 2018) in torch: networks, update, learner, compilation.

::

    policy         a = tanh(u), u = mu(o) + sigma(o) eps, eps ~ N(0, I)
                   log pi(a|o) = sum_j [log N(u_j; mu_j, sigma_j) - log(1 - a_j^2)]
    targets        y = c r + gamma (1 - d) (min_i Q'_i(o', a') - alpha log pi(a'|o')), a' ~ pi(o')
    critics        descend 1/2 sum_i mean (Q_i(o, a) - y)^2
    actor          descends mean(alpha log pi(a|o) - min_i Q_i(o, a)), a ~ pi(o)
    temperature    log alpha descends -log alpha (mean log pi(a|o) + target entropy)
    Polyak         Q' <- Q' + tau (Q - Q')

Independent of hydraulics, ROS and processes. To change a loss, change `update`: gradients are autograd's, steps are
torch's Adam. `update` is traced with its gradients and optimizer steps into one graph, which set-up compiles
(`compile_update`); without it the same function runs as it stands, at a fifth of the speed.
"""

from __future__ import annotations

import hashlib
import inspect
import math
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import softplus
from torch.optim.adam import adam

from hydro_policy.sac.agent import MOMENTS, OPTIMIZED, Agent, Losses, ReplayBuffer, layer_shapes
from hydro_policy.sac.settings import SacSettings

# ---------------------------------------------------------------------------------------------------------- networks


def perceptron(flat: Tensor, inputs: Tensor, hidden: int, outputs: int) -> Tensor:
    """Return the outputs [member, batch, outputs] of perceptrons with two hidden layers of ReLU, all in one product.

    `flat`: weights and biases in the order of `layer_shapes`. `inputs`: [member, batch, inputs].
    """
    shapes = layer_shapes(inputs.shape[0], inputs.shape[2], hidden, outputs)
    parts = flat.split([math.prod(shape) for shape in shapes])
    w1, b1, w2, b2, w3, b3 = (part.view(shape) for part, shape in zip(parts, shapes, strict=True))
    h1 = torch.relu(torch.baddbmm(b1, inputs, w1))
    h2 = torch.relu(torch.baddbmm(b2, h1, w2))
    if outputs == 1:  # a batched product with a single column takes three times as long
        return (h2 * w3.mT).sum(2, keepdim=True) + b3
    return torch.baddbmm(b3, h2, w3)


def sample(actor: Tensor, o: Tensor, noise: Tensor, c: Constants) -> tuple[Tensor, Tensor]:
    """Return actions a = tanh(u), u = mu + sigma noise, [batch, actions], and log pi(a|o), [batch]."""
    mean, raw = perceptron(actor, o[None], c.hidden, 2 * c.actions)[0].chunk(2, dim=1)
    log_std = raw.clamp(c.log_std_min, c.log_std_max)
    u = mean + log_std.exp() * noise
    normal = -0.5 * noise.square() - log_std - 0.5 * math.log(2.0 * math.pi)
    squash = 2.0 * (math.log(2.0) - u - softplus(-2.0 * u))  # log(1 - tanh^2 u)
    return torch.tanh(u), (normal - squash).sum(1)


def q_values(critics: Tensor, o: Tensor, a: Tensor, c: Constants) -> Tensor:
    """Return Q_i(o, a) of both critics, [2, batch]."""
    inputs = torch.cat((o, a), 1).expand(2, -1, -1)
    return perceptron(critics, inputs, c.hidden, 1)[..., 0]


# ------------------------------------------------------------------------------------------------------------ update


class Constants(NamedTuple):
    """Sizes, which the graph contains, and hyperparameters [1], which are its inputs (`Sac`)."""

    observations: int
    actions: int
    hidden: int
    actor_learning_rate: Tensor
    critic_learning_rate: Tensor
    entropy_learning_rate: Tensor
    gamma: Tensor
    tau: Tensor
    reward_scale: Tensor
    target_entropy: Tensor
    log_std_min: Tensor
    log_std_max: Tensor


class Optimizer(NamedTuple):
    """Parameters, and their state in torch's Adam: flat vectors, updated in place."""

    parameters: Tensor
    first_moment: Tensor
    second_moment: Tensor
    step: Tensor

    def leaf(self) -> Tensor:
        """Return the parameters, on the same memory, as what a loss is differentiated by."""
        return self.parameters.detach().requires_grad_()

    def descend(self, loss: Tensor, leaf: Tensor, learning_rate: Tensor) -> None:
        """Take one step of Adam down the gradient of `loss`."""
        (gradient,) = torch.autograd.grad(loss, leaf)
        with torch.no_grad():
            adam(
                [self.parameters], [gradient], [self.first_moment], [self.second_moment], [], [self.step],
                lr=learning_rate, beta1=0.9, beta2=0.999, eps=1e-8, weight_decay=0.0, amsgrad=False, maximize=False,
                foreach=False, differentiable=True,  # of its forms the one whose step can be traced
            )  # fmt: skip


def update(
    actor: Optimizer, critics: Optimizer, entropy: Optimizer, targets: Tensor, batch: Tensor, noise: Tensor,
    c: Constants,
) -> Tensor:  # fmt: skip
    """Perform one update in place; returns the losses [3] of critics, actor and temperature before it.

    `batch`: transitions [batch, o | o' | a | r | d]. `noise`: standard normal, [2, batch, actions], first for the
    targets, then for the actor.
    """
    o, following, a, reward, terminated = batch.split((c.observations, c.observations, c.actions, 1, 1), dim=1)
    theta, phi, log_alpha = actor.leaf(), critics.leaf(), entropy.leaf()
    alpha = log_alpha.detach().exp()

    with torch.no_grad():
        next_action, next_log_pi = sample(theta, following, noise[0], c)
        value = q_values(targets, following, next_action, c).amin(0) - alpha * next_log_pi
        y = c.reward_scale * reward[:, 0] + c.gamma * (1.0 - terminated[:, 0]) * value
    critic_loss = 0.5 * (q_values(phi, o, a, c) - y).square().mean(1).sum()
    critics.descend(critic_loss, phi, c.critic_learning_rate)

    action, log_pi = sample(theta, o, noise[1], c)
    actor_loss = (alpha * log_pi - q_values(phi.detach(), o, action, c).amin(0)).mean()
    actor.descend(actor_loss, theta, c.actor_learning_rate)

    entropy_loss = -(log_alpha * (log_pi.detach().mean() + c.target_entropy)).sum()
    entropy.descend(entropy_loss, log_alpha, c.entropy_learning_rate)

    targets.lerp_(critics.parameters, c.tau)
    return torch.stack((critic_loss, actor_loss, entropy_loss)).detach()


# ----------------------------------------------------------------------------------------------------------- learner


class Sac(Agent):
    """Agent that learns; arguments as `Agent`.

    Batches and noise of an update follow from the seed and the number of the update: no generator has to be saved. One
    thread, here set for torch in this process: at these sizes more only wait for each other, and round differently.
    """

    def __init__(self, observations: int, actions: int, settings: SacSettings, dtype: Any = np.float32) -> None:
        super().__init__(observations, actions, settings, dtype)
        torch.set_num_threads(1)
        self._tensors = [torch.from_numpy(vector) for vector in self.vectors.values()]
        numbers = [getattr(settings, name) for name in Constants._fields[3:]]
        self._constants = list(torch.tensor(numbers, dtype=self._tensors[0].dtype).unsqueeze(1))
        self._update = compiled_update(observations, actions, settings.hidden_size) if dtype == np.float32 else None
        self.losses = Losses()
        """Losses, mean over the updates of the last `learn`."""

    @property
    def compiled(self) -> bool:
        """Whether updates run compiled."""
        return self._update is not None

    def draw(self, replay: ReplayBuffer, updates: int) -> tuple[NDArray[np.float32], NDArray[Any]]:
        """Draw batches [updates, batch, width] and noise [updates, 2, batch, actions] of the next updates."""
        rng = np.random.default_rng((self.settings.seed, self.updates))
        indices = replay.draw((updates, self.settings.batch_size), rng)
        shape = (updates, 2, self.settings.batch_size, self.sizes[1])
        return replay.rows[indices], rng.standard_normal(shape, self._tensors[0].numpy().dtype)

    def learn(self, replay: ReplayBuffer, updates: int) -> None:
        """Update critics, actor, temperature and targets, `updates` times."""
        call = self._update or flat_update(*self.sizes, self.settings.hidden_size)
        batches, noise = map(torch.from_numpy, self.draw(replay, updates))
        steps = [torch.tensor(float(self.steps), dtype=noise.dtype) for _ in OPTIMIZED]
        batches, losses = batches.to(noise.dtype), torch.empty((updates, 3), dtype=noise.dtype)
        for k in range(updates):
            losses[k] = call([*self._tensors, *steps, batches[k], noise[k], *self._constants])
        self.losses = Losses(*losses.mean(0).tolist())
        self.state[:2] += updates


# ------------------------------------------------------------------------------------------------------- compilation


def flat_update(observations: int, actions: int, hidden: int) -> Callable[[Sequence[Tensor]], Tensor]:
    """Return `update` as a function of one list: an agent's vectors, three steps, batch, noise, hyperparameters."""
    count = len(OPTIMIZED) * len(MOMENTS)

    def call(tensors: Sequence[Tensor]) -> Tensor:
        steps = tensors[count + 1 : count + 4]
        groups = zip(tensors[0:count:3], tensors[1:count:3], tensors[2:count:3], steps, strict=True)
        actor, critics, entropy = (Optimizer(*group) for group in groups)
        batch, noise, *constants = tensors[count + 4 :]
        c = Constants(observations, actions, hidden, *constants)
        with torch.enable_grad():
            return update(actor, critics, entropy, tensors[count], batch, noise, c)

    return call


def package_file(observations: int, actions: int, hidden: int) -> Path:
    """Return where the compiled update of these sizes is kept: where numba keeps kernels (`hydro_sim.jit`).

    Its name follows from the processor, torch and the source.
    """
    here = Path(__file__)
    content = hashlib.blake2b(torch.__version__.encode(), digest_size=8)
    flags = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith(("flags", "Features"))]
    content.update("".join(flags[:1]).encode())
    content.update(here.read_bytes() + inspect.getsource(layer_shapes).encode())
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or here.parent / "__pycache__")
    if not os.access(folder if folder.exists() else here.parent, os.W_OK):
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hydro"
    return folder / f"update-{observations}-{actions}-{hidden}-{content.hexdigest()}.pt2"


def compiled_update(observations: int, actions: int, hidden: int) -> Callable[[Sequence[Tensor]], Tensor] | None:
    """Return the compiled `flat_update` of these sizes and any batch, or None if it has not been compiled here."""
    file = package_file(observations, actions, hidden)
    if not file.exists():
        return None
    loader = torch._C._aoti.AOTIModelPackageLoader(str(file), "model", False, 1, -1)  # torch._inductor: seconds more
    return lambda tensors: loader.run(list(tensors))[0]


def compile_update(observations: int, actions: int, hidden: int) -> str:
    """Compile `update` for these sizes, float32 and any batch, unless that is done; takes 20 s.

    Returns why it cannot be compiled, or an empty text: without a C++ compiler updates run uncompiled.
    """
    file = package_file(observations, actions, hidden)
    if file.exists():
        return ""
    if not any(map(shutil.which, (os.environ.get("CXX") or "c++", "g++", "clang++"))):
        return "there is no C++ compiler: updates run uncompiled, at a fifth of their speed"
    from torch.fx.experimental.proxy_tensor import make_fx

    if log := os.environ.get("HYDRO_COMPILATIONS"):
        with open(log, "a") as lines:
            lines.write(f"hydro_policy.sac.sac.update {observations} {actions} {hidden}\n")
    torch.set_num_threads(1)
    sac = Sac(observations, actions, SacSettings(hidden_size=hidden))
    steps = [torch.zeros(()) for _ in OPTIMIZED]
    batch, noise = torch.zeros(256, 2 * observations + actions + 2), torch.zeros(2, 256, actions)
    inputs = [*(tensor.clone() for tensor in sac._tensors), *steps, batch, noise, *sac._constants]
    size = torch.export.Dim("batch", min=2, max=1 << 20)
    dynamic: list[Any] = [None] * len(inputs)
    at = len(sac._tensors) + len(steps)
    dynamic[at : at + 2] = {0: size}, {1: size}
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=file.parent) as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about torch's own calls
        os.environ["TORCHINDUCTOR_CACHE_DIR"] = folder
        graph = make_fx(flat_update(observations, actions, hidden), tracing_mode="symbolic")(inputs)
        with torch.no_grad():
            program = torch.export.export(graph, (inputs,), dynamic_shapes=(dynamic,))
        options = {"aot_inductor.compile_wrapper_opt_level": "O1", "compile_threads": 1}
        made = torch._inductor.aoti_compile_and_package(
            program, package_path=f"{folder}/update.pt2", inductor_configs=options
        )
        os.replace(made, file)
        del os.environ["TORCHINDUCTOR_CACHE_DIR"]
    return ""
