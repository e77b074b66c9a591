/* SPDX-License-Identifier: Apache-2.0 */
/* What takes the place of the code generator in tests: a block's calls in the order in which Simulink makes them. */
#include <stdlib.h>
#include <string.h>

const char *run_block(const double *parameters, size_t count, long samples, const double *in, double *out);

/* Run a block: its first input, one number a sample, and its first output, by rows. Returns its error, or NULL. */
const char *run_block(const double *parameters, size_t count, long samples, const double *in, double *out)
{
    SimStruct *S = calloc(1, sizeof *S);
    const char *error;
    double given[600];
    memcpy(given, parameters, count * sizeof *given);
    S->parameter.numbers = given;
    S->parameter.count = count;
    mdlInitializeSizes(S);
    mdlInitializeSampleTimes(S);
#ifdef MDL_START
    mdlStart(S);
#endif
#ifdef MDL_INITIALIZE_CONDITIONS
    mdlInitializeConditions(S);
#endif
    for (long k = 0; k < samples && !S->error; k++) {
        S->in[0][0] = in[k];
        mdlOutputs(S, 0);
        memcpy(out + k * S->output_width[0], S->out[0], (size_t)S->output_width[0] * sizeof *out);
#ifdef MDL_UPDATE
        mdlUpdate(S, 0);
#endif
    }
    mdlTerminate(S);
    error = S->works && S->work_width > 4000 ? "the stub has no room for this block" : S->error;
    free(S);
    return error;
}
