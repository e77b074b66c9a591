/* SPDX-License-Identifier: Apache-2.0 */
/* Samples from standard input, decisions of the default filter to standard output.
 *
 * In: 15 numbers each, those of STATE and then whether it is armed. Out: delta_u, M_c before and after, status. All are
 * hydro_real as they lie in memory. A floating-point exception ends the program. filter_config.h is generated.
 */
#define _GNU_SOURCE
#include <fenv.h>
#include <stdio.h>

#include "filter_config.h"

int main(void)
{
    hydro_memory_of_loop memory = {0};
    hydro_real in[HYDRO_STATE_REALS + 1], out[4];
    feenableexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
    while (fread(in, sizeof in, 1, stdin) == 1) {
        hydro_decision made = hydro_decide_loop(&HYDRO_LOOP_FILTER, &memory, in, in[HYDRO_STATE_REALS] > HYDRO_R(0));
        out[0] = made.delta_u;
        out[1] = made.before;
        out[2] = made.after;
        out[3] = (hydro_real)made.status;
        if (fwrite(out, sizeof out, 1, stdout) != 1) {
            return 1;
        }
    }
    return 0;
}
