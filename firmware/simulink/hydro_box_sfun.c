/* SPDX-License-Identifier: Apache-2.0 */
/* The box as a Simulink level-2 C S-function, one instance per model. Not tried on dSPACE hardware.
 *
 * in 1   uint8[512]   bytes from the serial receive block
 * in 2   uint32       how many of them are new
 * in 3   double[5]    f_h N, f_l N, p_a Pa, p_b Pa, x_p m
 * out 1  double       valve current A, to hold until the next sample
 * out 2  uint8[516]   bytes for the serial send block
 * out 3  uint32       how many of them to send
 * parameter: epoch, a double: a number that differs at each start, above 0
 */
#define S_FUNCTION_NAME hydro_box_sfun
#define S_FUNCTION_LEVEL 2
#include "simstruc.h"

#include "../hydro/box.h"

#include "box_config.h"

#define BYTES 512

static hydro_box box;
static hydro_rates rates;
static hydro_real measurement[HYDRO_MEASURED];
static uint32_t tick;

static void mdlInitializeSizes(SimStruct *S)
{
    ssSetNumSFcnParams(S, 1);
    if (ssGetNumSFcnParams(S) != ssGetSFcnParamsCount(S)) {
        return;
    }
    if (!ssSetNumInputPorts(S, 3) || !ssSetNumOutputPorts(S, 3)) {
        return;
    }
    ssSetInputPortWidth(S, 0, BYTES);
    ssSetInputPortDataType(S, 0, SS_UINT8);
    ssSetInputPortWidth(S, 1, 1);
    ssSetInputPortDataType(S, 1, SS_UINT32);
    ssSetInputPortWidth(S, 2, 5);
    for (int i = 0; i < 3; i++) {
        ssSetInputPortDirectFeedThrough(S, i, 1);
        ssSetInputPortRequiredContiguous(S, i, 1);
    }
    ssSetOutputPortWidth(S, 0, 1);
    ssSetOutputPortWidth(S, 1, HYDRO_BURST_MAX);
    ssSetOutputPortDataType(S, 1, SS_UINT8);
    ssSetOutputPortWidth(S, 2, 1);
    ssSetOutputPortDataType(S, 2, SS_UINT32);
    ssSetNumSampleTimes(S, 1);
}

static void mdlInitializeSampleTimes(SimStruct *S)
{
    ssSetSampleTime(S, 0, HYDRO_PERIOD);
    ssSetOffsetTime(S, 0, 0.0);
}

#define MDL_START
static void mdlStart(SimStruct *S)
{
    hydro_box_power_on(&box, &HYDRO_BOX_CONFIG, (uint32_t)mxGetScalar(ssGetSFcnParam(S, 0)));
    hydro_rates_reset(&rates, &HYDRO_BOX_CONFIG);
    tick = 0;
}

static void mdlOutputs(SimStruct *S, int_T tid)
{
    const uint8_t *bytes = (const uint8_t *)ssGetInputPortSignal(S, 0);
    uint32_t count = *(const uint32_t *)ssGetInputPortSignal(S, 1);
    const double *given = (const double *)ssGetInputPortSignal(S, 2);
    hydro_real raw[5];
    (void)tid;
    hydro_box_bytes(&box, bytes, count < BYTES ? count : BYTES);
    for (int i = 0; i < 5; i++) {
        raw[i] = (hydro_real)given[i];
    }
    hydro_differentiate(&rates, raw, measurement);
    *(double *)ssGetOutputPortSignal(S, 0) = hydro_box_tick(&box, measurement, (hydro_time)tick++ * HYDRO_PERIOD);
    *(uint32_t *)ssGetOutputPortSignal(S, 2) =
        (uint32_t)hydro_box_frames(&box, (uint8_t *)ssGetOutputPortSignal(S, 1));
}

static void mdlTerminate(SimStruct *S)
{
    (void)S;
}

#ifdef MATLAB_MEX_FILE
#include "simulink.c"
#else
#include "cg_sfun.h"
#endif
