/* SPDX-License-Identifier: Apache-2.0 */
/* Samples from standard input, decisions of the filter to standard output.
 *
 * In: 18 numbers each, those of hydro_loop_sample in their order, `armed` as a number. Out: delta_u, M_c before and
 * after, status, and the equation of the model that is broken. All are hydro_real as they lie in memory. A
 * floating-point exception ends the program. filter_config.h is generated.
 */
#define _GNU_SOURCE
#include <fenv.h>
#include <stdio.h>

#include "filter_config.h"
#include "hydro/monitor.h"

int main(void)
{
    static hydro_memory_of_loop memory;
    static hydro_monitor monitor;
    hydro_real in[HYDRO_MEASURED + 10], out[5];
    feenableexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
    while (fread(in, sizeof in, 1, stdin) == 1) {
        hydro_loop_sample sample = {
            .nominal = in[8], .current = in[9], .reference = in[10], .reference_rate = in[11], .k_p = in[12],
            .followed = in[13], .followed_rate = in[14], .c_1 = in[15], .c_2 = in[16], .armed = in[17] > HYDRO_R(0)};
        hydro_decision made;
        hydro_copy(sample.x, in, sizeof sample.x);
        if (hydro_believable(&HYDRO_LOOP_FILTER, &sample)) {
            hydro_watch(&HYDRO_LOOP_FILTER.loop, HYDRO_R(1), &monitor, &memory, sample.x);
        } else {
            hydro_monitor_skip(&monitor);
        }
        made = hydro_decide_loop(&HYDRO_LOOP_FILTER, &memory, &sample);
        out[0] = made.delta_u;
        out[1] = made.before;
        out[2] = made.after;
        out[3] = (hydro_real)made.status;
        out[4] = (hydro_real)monitor.broken;
        if (fwrite(out, sizeof out, 1, stdout) != 1) {
            return 1;
        }
    }
    return 0;
}
