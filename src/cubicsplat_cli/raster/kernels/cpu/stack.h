// The C interface to stacks of shapes: plain structs of numbers and pointers, mirrored field by field in stack.py.
#pragma once

#include "abi.h"

extern "C" {

// Opaque or translucent shapes back to front, each of one or more closed outlines.
struct CsStack {
  int32_t width, height, layers;
  int32_t grid;          // 0: exact areas; g: g x g samples a pixel
  const int32_t* ends;   // layers: how many pieces there are up to and with each layer
  const double* cubics;  // pieces x 4 x 2, px
  const uint8_t* lines;  // pieces
  const double* signs;   // pieces: 1, or -1 where an outline runs the wrong way round
  const double* inks;    // layers x 4, premultiplied
};

// What a picture is compared with.
struct CsFit {
  const double* target;  // H x W x 4, premultiplied
  double channels[4];    // weights
  double bound;          // of a pixel's residual, beyond which it counts linearly
  int32_t reach;         // px, of the blur that the picture of the stack goes through first, 0 for none
  const double* taps;    // reach + 1: its weights along a row or column, from the middle on
};

// For each pixel that a piece crosses (twice where it comes back to one).
struct CsCrossings {
  int64_t room, count;  // where count > room the rest is missing
  int32_t* piece;
  int32_t* pixel;  // row times width plus column
  double* t;       // the piece's parameter there
  double* change;  // x 8: of the pixel's coverage with the piece's control points
  double* slope;   // x 4: of the picture with the coverage
};

// The normal equations over the control points of all pieces.
struct CsEquations {
  int32_t pieces, width, height;
  int64_t room, count;  // of the pairs of pieces that share pixels; where count > room the rest is missing
  int32_t* first;       // <= second
  int32_t* second;
  double* blocks;    // x 8 x 8
  double* gradient;  // pieces x 8
};

// image: H x W x 4 and misfit: H x W, written. Each returns 0, or 1 where there is no memory.
CS_EXPORT int32_t cs_stack_draw(const CsStack*, const CsFit*, double* image, double* misfit, CsCrossings*);
CS_EXPORT int32_t cs_stack_equations(const CsFit*, const double* image, const CsCrossings*, CsEquations*);
}
