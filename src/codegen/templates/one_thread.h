/* Written by phipsi; do not edit. CUDA kernels as C99: include this before them, and run them by ON_ALL_THREADS. */
#ifndef ONE_THREAD_H
#define ONE_THREAD_H

#include <math.h>
#include <stddef.h>

#define __global__ static
#define __device__ static
#define __forceinline__ inline __attribute__((unused))

typedef struct {
    unsigned x;
} one_thread_index;

static one_thread_index blockIdx, blockDim = {32}, threadIdx;

#define ON_ALL_THREADS(count, call) \
    for (size_t one_thread = 0; one_thread < ((count) + 31) / 32 * 32; one_thread++) { \
        blockIdx.x = (unsigned)(one_thread / 32); \
        threadIdx.x = (unsigned)(one_thread % 32); \
        call; \
    }

#endif
