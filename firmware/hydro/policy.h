/* SPDX-License-Identifier: Apache-2.0 */
/* Optional: a trained policy's mean action, from a sample to changes of K_p and K_i.
 *
 *   o = ([x, f_r, f_r', f_r - f_l, last action] - center) / scale
 *   action = tanh(W3' relu(W2' relu(W1' o + b1) + b2) + b3)          in [-1, 1], mapped to [low, high]
 *
 * To be called every tenth sample: the policy was trained at 100 Hz. Between two calls the gains stay. The header that
 * `ros2 run hydro_policy export_c` writes has the weights, HYDRO_POLICY, and includes this one.
 */
#ifndef HYDRO_POLICY_H
#define HYDRO_POLICY_H

#include "protocol.h"

#ifndef HYDRO_POLICY_UNITS
#error "HYDRO_POLICY_UNITS, units of each hidden layer, comes with the weights: include their header"
#endif

#ifndef HYDRO_TANH /* of the target; the compiler's own else */
#ifdef HYDRO_SINGLE
#define HYDRO_TANH(x) __builtin_tanhf(x)
#else
#define HYDRO_TANH(x) __builtin_tanh(x)
#endif
#endif

#define HYDRO_ACTIONS 2
#define HYDRO_OBSERVED (HYDRO_MEASURED + 3 + HYDRO_ACTIONS)
#define HYDRO_POLICY_STEP 10 /* samples */

/* Weights lie input by input: weight[i * outputs + j]. They are float32 in the policy's file. */
typedef struct {
    const float *weight[3], *bias[3];
    hydro_real center[HYDRO_OBSERVED], scale[HYDRO_OBSERVED];
    hydro_real low[HYDRO_ACTIONS], high[HYDRO_ACTIONS]; /* delta_kp 1/s, delta_ki 1/s^2 */
} hydro_policy;

static inline void hydro_dense(
    const float *weight, const float *bias, int inputs, int outputs, const hydro_real *x, hydro_real *y)
{
    for (int j = 0; j < outputs; j++) {
        y[j] = (hydro_real)bias[j];
    }
    for (int i = 0; i < inputs; i++) {
        for (int j = 0; j < outputs; j++) {
            y[j] += (hydro_real)weight[i * outputs + j] * x[i];
        }
    }
}

static inline void hydro_relu(hydro_real *y)
{
    for (int j = 0; j < HYDRO_POLICY_UNITS; j++) {
        y[j] = hydro_max(y[j], HYDRO_R(0));
    }
}

/* `values` of a sample and the last action, which is 0 at first, into the observation; false if it is none of a bench. */
static inline bool hydro_observe(
    const hydro_policy *policy, const hydro_real *values, const hydro_real *action, hydro_real *observation)
{
    for (int i = 0; i <= HYDRO_REFERENCE_RATE; i++) {
        if (!hydro_within(values[i], HYDRO_R(1e9))) {
            return false;
        }
    }
    hydro_copy(observation, values, HYDRO_MEASURED * sizeof *values);
    observation[8] = values[HYDRO_REFERENCE];
    observation[9] = values[HYDRO_REFERENCE_RATE];
    observation[10] = values[HYDRO_REFERENCE] - values[2];
    hydro_copy(observation + 11, action, HYDRO_ACTIONS * sizeof *action);
    for (int i = 0; i < HYDRO_OBSERVED; i++) {
        observation[i] = (observation[i] - policy->center[i]) / policy->scale[i];
    }
    return true;
}

/* One step: moves `action` on, unless the sample is none of a bench, and gives delta_kp [1/s] and delta_ki [1/s^2]. */
static inline void hydro_act(
    const hydro_policy *policy, const hydro_real *values, hydro_real action[HYDRO_ACTIONS],
    hydro_real gains[HYDRO_ACTIONS])
{
    hydro_real observation[HYDRO_OBSERVED], first[HYDRO_POLICY_UNITS], second[HYDRO_POLICY_UNITS];
    if (hydro_observe(policy, values, action, observation)) {
        hydro_dense(policy->weight[0], policy->bias[0], HYDRO_OBSERVED, HYDRO_POLICY_UNITS, observation, first);
        hydro_relu(first);
        hydro_dense(policy->weight[1], policy->bias[1], HYDRO_POLICY_UNITS, HYDRO_POLICY_UNITS, first, second);
        hydro_relu(second);
        hydro_dense(policy->weight[2], policy->bias[2], HYDRO_POLICY_UNITS, HYDRO_ACTIONS, second, action);
        for (int i = 0; i < HYDRO_ACTIONS; i++) {
            action[i] = HYDRO_TANH(action[i]);
        }
    }
    for (int i = 0; i < HYDRO_ACTIONS; i++) {
        hydro_real within = hydro_clamp(action[i], HYDRO_R(-1), HYDRO_R(1));
        gains[i] = policy->low[i] + HYDRO_R(0.5) * (within + HYDRO_R(1)) * (policy->high[i] - policy->low[i]);
    }
}

#endif
