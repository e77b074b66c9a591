/* SPDX-License-Identifier: Apache-2.0 */
/* The box as a shared library, for the emulator and the tests. The caller gives the memory. */
#include "hydro/box.h"

size_t hydro_c_box_size(void)
{
    return sizeof(hydro_box);
}

size_t hydro_c_config_size(void)
{
    return sizeof(hydro_config);
}

void hydro_c_power_on(hydro_box *box, const hydro_config *config, uint32_t epoch)
{
    hydro_box_power_on(box, config, epoch);
}

void hydro_c_bytes(hydro_box *box, const uint8_t *data, size_t count)
{
    hydro_box_bytes(box, data, count);
}

void hydro_c_tick(hydro_box *box, const double *measurement, double time, hydro_sample *sample)
{
    hydro_real values[HYDRO_MEASURED];
    for (int i = 0; i < HYDRO_MEASURED; i++) {
        values[i] = (hydro_real)measurement[i];
    }
    (void)hydro_box_tick(box, values, time);
    *sample = box->sample;
}

size_t hydro_c_frames(hydro_box *box, uint8_t *out)
{
    return hydro_box_frames(box, out);
}

void hydro_c_counts(const hydro_box *box, uint32_t counts[6])
{
    counts[0] = box->taken;
    counts[1] = box->stale;
    counts[2] = box->greetings;
    counts[3] = box->guard.refused[0];
    counts[4] = box->guard.refused[1];
    counts[5] = box->last_command;
}

/* The force law of the last sample: its number, f_c, f_c', a_0 to a_3, C_1, C_2. */
void hydro_c_law_state(const hydro_box *box, double out[9])
{
    out[0] = box->acting.law;
    out[1] = box->acting.reference;
    out[2] = box->acting.reference_rate;
    for (int i = 0; i < HYDRO_SHAPING; i++) {
        out[3 + i] = box->acting.shaping[i];
    }
}
