/* SPDX-License-Identifier: Apache-2.0 */
/* Runs samples of one kind, for counting: operations KIND SAMPLES; `size` prints the bytes of a box instead.
 * A COMMAND comes in and a STATE goes out with each sample, with `greeting` a HELLO in, and HELLO, DETAILS, LAW, STATE out.
 * `host` is what this program does for the host; `policy` is one decision.
 */
#include "check.h"

#define HYDRO_POLICY_UNITS 32
#include "../hydro/policy.h"

static void actions(uint32_t samples)
{
    static float weight[HYDRO_POLICY_UNITS * HYDRO_POLICY_UNITS], bias[HYDRO_POLICY_UNITS];
    hydro_policy policy = {.weight = {weight, weight, weight}, .bias = {bias, bias, bias}, .high = {75, 10}};
    hydro_real values[HYDRO_STATE_REALS] = {0}, action[HYDRO_ACTIONS] = {0}, gains[HYDRO_ACTIONS];
    for (int i = 0; i < HYDRO_OBSERVED; i++) {
        policy.scale[i] = HYDRO_R(1);
    }
    for (int i = 0; i < HYDRO_POLICY_UNITS; i++) {
        bias[i] = 0.1f;
        for (int j = 0; j < HYDRO_POLICY_UNITS; j++) {
            weight[i * HYDRO_POLICY_UNITS + j] = 0.01f * (float)(i - j);
        }
    }
    for (uint32_t k = 0; k < samples; k++) {
        values[0] = HYDRO_R(k % 100);
        hydro_act(&policy, values, action, gains);
        CHECK(gains[0] >= 0 && gains[0] <= 75);
    }
}

int main(int argc, char **argv)
{
    static const char *const kinds[8] = {"hold", "sine", "multisine", "smooth_step", "fade", "disarmed",
                                         "greeting", "host"};
    static hydro_box box;
    const float gains[3] = {10.0f, 1.0f, 0.001f};
    const float shaping[HYDRO_SHAPING] = {1.0f, 0.03125f, 0.001f, 1.0f, 1e-5f, 0.25f, 1.0f};
    uint8_t payload[72] = {0}, wire[HYDRO_ENCODED_MAX], out[HYDRO_BURST_MAX];
    uint32_t kind = 0, samples = argc > 2 ? (uint32_t)strtoul(argv[2], NULL, 10) : 1000;
    CHECK(argc > 2);
    if (strcmp(argv[1], "size") == 0) {
        printf("%zu\n", sizeof box);
        return 0;
    }
    if (strcmp(argv[1], "policy") == 0) {
        actions(samples);
        return 0;
    }
    while (kind < 8 && strcmp(argv[1], kinds[kind]) != 0) {
        kind++;
    }
    CHECK(kind < 8);
    hydro_box_power_on(&box, &CONFIG, 1);
    for (uint32_t k = 0; k < samples + 400; k++) {
        /* the fade that costs most: a new multisine while the last one leaves, again and again */
        float shape[4] = {kind == 0 ? 0.0f : 100.0f, kind == 4 ? (float)(k / 300 % 2) : 0.0f, 1.1f, 0.3f};
        if (kind == 6) {
            uint8_t hello[72] = {1, 3};
            hydro_box_bytes(&box, wire, host_frame(0, HYDRO_HELLO, 0, hello, 72, wire));
        }
        host_command(payload, kind == 5 || k == 0 ? 0u : 3u, gains, kind == 4 ? HYDRO_MULTISINE : kind % 4, shape);
        payload[40] = HYDRO_COMPENSATED;
        memcpy(payload + 44, shaping, sizeof shaping);
        size_t count = host_frame(HYDRO_VERSION, HYDRO_COMMAND, k + 1, payload, 72, wire);
        if (kind == 7) {
            CHECK(count == 93 && wire[0] == 0);
            continue;
        }
        hydro_box_bytes(&box, wire, count);
        (void)hydro_box_tick(&box, STILL, k * HYDRO_PERIOD);
        (void)hydro_box_frames(&box, out);
    }
    CHECK(kind >= 5 || (box.sample.flags & HYDRO_ARMED) != 0);
    return 0;
}
