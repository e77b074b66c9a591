# %% [markdown]
# # Train a policy in simulation
#
# Soft Actor-Critic on eight simulated benches at once, as `ros2 run hydro_policy pretrain` does it: some episodes of
# the paper's 160 here. `run.round()` plays one episode on each bench and examines the mean action afterwards.
# %%
from dataclasses import replace

import matplotlib.pyplot as plt
import pandas as pd

from hydro_policy.pretraining.configurations import configuration
from hydro_policy.pretraining.training import Pretraining, PretrainSettings
from hydro_policy.task.mdp import observe
from hydro_sim.model.bench import Bench

EPISODES = 24
bench = Bench.nominal()
training = replace(configuration("wide"), episodes=EPISODES)
run = Pretraining(PretrainSettings(training=training), bench, bench)
while not run.finished:
    run.round()
history = pd.DataFrame(run.history)
history[["episode", "return", "trips", "score", "updates"]]
# %% [markdown]
# The score is the RMSE over that of fixed gains (90, 15): below 1 the policy is better.
# %%
figure, axes = plt.subplots(figsize=(8, 3))
axes.plot(history.episode, history.score, marker=".")
axes.axhline(1.0, color="0.5", linestyle="--")
axes.set(xlabel="episodes", ylabel="RMSE / fixed (90, 15)")
plt.savefig("/tmp/w/nb/"+__file__.split("/")[-1]+".png")
# %% [markdown]
# The gains that it chooses for the samples of the last step, K_p [1/s] and K_i [1/s^2] on top of the base gains.
# %%
samples = run.environment.fleet.samples if hasattr(run.environment, "fleet") else run.fleet.samples
observe
