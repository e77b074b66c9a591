/* SPDX-License-Identifier: Apache-2.0 */
/* As much of Simulink's simstruc.h as the S-functions here use, for tests: a block is a structure with fixed room. */
#ifndef SIMSTRUC_STUB_H
#define SIMSTRUC_STUB_H

#include <stddef.h>
#include <stdint.h>

typedef int int_T;
typedef double real_T;
typedef struct { double *numbers; size_t count; } mxArray;
enum { SS_DOUBLE, SS_UINT8, SS_UINT32 };

typedef struct {
    mxArray parameter;
    int expected, inputs, outputs, input_width[4], output_width[4], feeds[4], times, works, work_width;
    double sample_time, offset, work[4000], in[4][600], out[4][600];
    const char *error;
} SimStruct;

#define ssSetNumSFcnParams(S, n) ((S)->expected = (n))
#define ssGetNumSFcnParams(S) ((S)->expected)
#define ssGetSFcnParamsCount(S) 1
#define ssGetSFcnParam(S, i) ((const mxArray *)&(S)[i].parameter)
#define ssSetNumInputPorts(S, n) ((S)->inputs = (n), 1)
#define ssSetNumOutputPorts(S, n) ((S)->outputs = (n), 1)
#define ssSetInputPortWidth(S, i, n) ((S)->input_width[i] = (n))
#define ssSetOutputPortWidth(S, i, n) ((S)->output_width[i] = (n))
#define ssSetInputPortDataType(S, i, type) ((void)(S), (void)(type))
#define ssSetOutputPortDataType(S, i, type) ((void)(S), (void)(type))
#define ssSetInputPortDirectFeedThrough(S, i, yes) ((S)->feeds[i] = (yes))
#define ssSetInputPortRequiredContiguous(S, i, yes) ((void)(S), (void)(yes))
#define ssSetNumSampleTimes(S, n) ((S)->times = (n))
#define ssSetSampleTime(S, i, t) ((S)->sample_time = (t))
#define ssSetOffsetTime(S, i, t) ((S)->offset = (t))
#define ssSetNumDWork(S, n) ((S)->works = (n))
#define ssSetDWorkWidth(S, i, n) ((S)->work_width = (n))
#define ssSetDWorkDataType(S, i, type) ((void)(S), (void)(type))
#define ssGetDWork(S, i) ((void *)(S)->work)
#define ssGetInputPortSignal(S, i) ((const void *)(S)->in[i])
#define ssGetOutputPortSignal(S, i) ((void *)(S)->out[i])
#define ssSetErrorStatus(S, text) ((S)->error = (text))
#define mxGetNumberOfElements(array) ((array)->count)
#define mxGetPr(array) ((array)->numbers)
#define mxGetScalar(array) ((array)->numbers[0])

#endif
