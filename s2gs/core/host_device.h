#pragma once

/// Marks a function that is compiled for the CPU and, by nvcc, for the GPU as well.
#if defined(__CUDACC__)
#define S2GS_HD __host__ __device__
#else
#define S2GS_HD
#endif
