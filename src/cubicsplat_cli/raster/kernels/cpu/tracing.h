// Functions of the tracing that contour_fit.cpp calls; they are described where they are defined.
#pragma once

#include <cstdint>

#include "abi.h"

extern "C" {

CS_EXPORT int64_t cs_corners(int64_t count, const double* points, const double* weights, int64_t* indices,
                             double* positions, double* turns);
CS_EXPORT int64_t cs_lay_out(int64_t count, const double* points, const double* weights, int64_t corners,
                             const int64_t* index, const double* position, const double* turn, const uint8_t* sure,
                             double price, uint8_t* kept, int64_t* start, double* chosen, int64_t* sizes,
                             double* anchors, double* handles, uint8_t* lines, uint8_t* level, uint8_t* from_corner);
CS_EXPORT int64_t cs_count_variables(int64_t anchors, int64_t pieces, const uint8_t* lines, const uint8_t* smooth,
                                     const uint8_t* level, const int64_t* tied);
CS_EXPORT double cs_refine(int64_t anchors, int64_t pieces, const uint8_t* lines, const uint8_t* smooth,
                           const uint8_t* level, const int64_t* tied, double* at, double* incoming, double* outgoing,
                           int64_t count, const double* points, const double* weights, int64_t* piece, double* u,
                           int64_t rounds);
CS_EXPORT int64_t cs_nearest_primitive(int64_t count, const double* points, const double* weights, double price,
                                       int32_t* form, double* values, double* told);
CS_EXPORT int32_t cs_fewer_points(int64_t count, const double* points, double tolerance, uint8_t* kept);
}
