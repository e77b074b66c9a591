# SPDX-License-Identifier: Apache-2.0
"""What the page says around its tables: how each was made, and what the paper leaves open."""

HEAD = """# The paper, row by row

*This page is made by `make paper` from the pieces that were run; do not edit it.*

The paper's own method on the emulated bench, beside the paper's numbers and ours. All figures but the paper's are the
emulator's: orders and signs compare, Newtons do not. *quick*: `make paper ARGS=--quick`, sizes far below the paper's,
which show that the method runs and nothing about what it comes to; *full*: `make paper`, hours. A row that is not
there was not run yet. Cells: mean ± standard deviation over seeds, where there is more than one. The pieces that the
page is made from lie in benchmarks/paper/results; `make paper ARGS=--fresh` runs them all again.
"""

CLAIMS = """
## Claims

*as the paper says* (in all comparisons: holds; in some: in part) of all comparisons, seeds together. A quick run gives
counts and no verdict. The filter meant is the paper's after its three epochs, *paper-short* below, where a claim does
not say ours.
"""

OPEN = """
## What the paper leaves open

- *Normalized* errors: over each state's range here; over the standard deviation in the pieces' `over_std`.
- The share in gamma_2 and gamma_4 is of violations here: "verified" in 0.14 % of the steps of a stable controller, as
  the text has it, would be a certificate that never holds.
- v has the sign of the erratum: with the printed one a correction pushes the force away from its reference.
- A, B, K are exact slopes, where the paper takes differences; the metric's rollouts: K_p -40 to 200 1/s, without noise.
- II is trained on the shipped model, not on the 2x32 network: the gap from simulation to bench is the smaller for it.
- Not in Table training_agent: batch 256, target entropy -2, fixed scales of the observation, the reward's factor 0.02.
  How much hangs on them is in "Sensitivity" of each size.
- No filter stands in the runs of Table rmse. *I* is the best policy by the run's own examinations, two runs of each
  sine, better than the one that came by more than their noise; *last policy* is what the training ended with.
- I's actor learns at a tenth of the paper's rate, and not before an episode of the bench is there: `trainer`'s way with
  an agent that is good already.
- *no difference* is said of numbers that are equal to the bit.
"""

TIMES = """
## Time

Seconds of CPU of a piece, most of them with other work on the machine. Where a full piece was not run, the whole counts
it as the quick one scaled by its work: epochs, episodes, rollouts, seconds.
"""

MODELS = """
### Table rmse_model

Made on recordings of the emulated bench's default truth (300 s to train on, 60 s to validate, 60 s to judge), no
filter; 70-sample predictions of x without noise, over each state's range. *squared*: the loss as meant; *printed*: as
printed; *one-step*: H = 1. The last columns: error of f_l after so many samples.
"""

METRICS = """
### Table training_metric

Made on rollouts of the paper's network model under fixed gains, no filter; judged on rollouts not trained on. Ours is
solved, not trained, on the shipped model, and judged on its rollouts; its loss is another one. The last of the paper's
rows ends when 20 epochs have lowered the best held-out loss by less than 1 %.
"""

VALIDATION = """
### Table val_cont

Made on the emulated bench's default truth, 200 N at 1 Hz, gains as `hydro_filter validate` draws them: *stable* (90,
15), *unstable* K_p -40 to 40, *negative* -40 to 0, *positive* 0 to 40, *high* 100 to 300. Filters: *paper-short* after
3 epochs and *paper-long* after all, at 100 Hz; *ours*, the shipped metric, at 1 kHz; *none*: bypassed, judged by ours.
gamma_2 and gamma_4: M_c > 0; gamma_3 and gamma_5 compare within a filter. RMSE and u' of a run that tripped: up to
there.
"""

RMSE = """
### Tables training_agent and rmse

Force RMSE [N], sines of 300 N, each from rest: 2 s to settle, then at least four periods. No filter, bumpless integral.
Authority *paper*: K_p 15 to 90, K_i 5 to 15; *wide*: to 300 and 100. Bench *default*: the emulated bench's truth;
*outside*: seals that rub with the pressure, cogging, flow forces, a slower spool.
"""

CHATTER = """
### Chattering in training

Of I's first two episodes: default bench, paper's authority; filters as in Table val_cont. An episode in which the box
trips is begun anew; a training ends after a minute for each episode, whatever it has done by then.
"""

SENSITIVITY = """
### Sensitivity

II under the paper's authority, in simulation, with other choices than ours (*as chosen*: batch 256, target entropy -2,
the reward's factor 0.02; observations over the reach of normal runs). *standardised*: mean 0 and deviation 1 of what
the first actor sees, as a running normaliser has it. *Score*: RMSE over that of fixed (90, 15), mean of the four sines,
of the training's best and last examination; the best of one seed is the least of many noisy ones.
"""
