// The C interface to stacks of shapes: plain structs of numbers and pointers, mirrored field by field in stack.py.
#pragma once

#include "abi.h"

extern "C" {

// What a picture of a stack is compared with; the arrays must outlive every picture drawn for it.
struct CsGoal {
  int32_t width, height;
  int32_t grid;           // 0: exact areas; g: g x g samples a pixel
  int32_t reach;          // px, of the blur that the picture of the stack goes through first, 0 for none
  int32_t threads;        // that may work on it: the same picture for any number
  const double* target;   // H x W x 4, premultiplied
  const double* taps;     // reach + 1: its weights along a row or column, from the middle on
  const uint8_t* opaque;  // H x W: where the background may not show, or null
  const double* half;     // H x W: residuals beyond which a pixel is wrong, of a picture without anti-aliasing; or null
  double channels[4];     // weights
  double bound;           // of a pixel's residual, beyond which it counts linearly
  double leak_weight;     // of the squared share of the background that shows where it may not
  double steep;           // weight of the square of a residual beyond `half`
};

struct CsPicture;  // a stack as it is drawn

// Opaque or translucent shapes back to front, each of one or more closed outlines.
struct CsStack {
  int32_t layers;
  const int32_t* ends;   // layers: how many pieces there are up to and with each layer
  const double* cubics;  // pieces x 4 x 2, px
  const uint8_t* lines;  // pieces
  const double* signs;   // pieces: 1, or -1 where an outline runs the wrong way round
  const double* fills;   // layers x 4, premultiplied
  // A picture of the same goal, or null: its layers, whose pieces get no numbers, are in the stack too.
  const CsPicture* base;
  const int32_t* beneath;  // layers: the layer of the base right above which each lies, ascending; -1 for none
};

// For each pixel that a piece crosses (twice where it comes back to one), in the order of the pieces.
struct CsCrossings {
  int32_t* piece;
  int32_t* pixel;  // row times width plus column
  double* t;       // the piece's parameter there
  double* change;  // x 8: of the pixel's coverage with the piece's control points
  double* slope;   // x 4: of the picture with the coverage
};

// The variables of some outlines, and how the control points of their pieces move with them: a sparse matrix by rows, 8
// a piece. Several outlines may move with the same variables.
struct CsUnknowns {
  int32_t outlines, variables;
  const int32_t* first;   // outlines: the number of the first piece
  const int32_t* count;   // outlines: of pieces
  const int32_t* start;   // outlines: the number of the first variable
  const int64_t* rows;    // 8 x all of their pieces + 1: where each row begins
  const int32_t* column;  // of a value: the variable, from the outline's first one on
  const double* value;
  const double* damping;  // variables: times the diagonal of the Gram matrix, what is added to it
  double keep;            // and what is added besides
};

// The picture of a stack, to be freed; null where there is no memory. previous: of the same goal and base, or null;
// what lies the same as in that one is not drawn again. A base must outlive its pictures.
CS_EXPORT CsPicture* cs_stack_draw(const CsGoal*, const CsStack*, const CsPicture* previous);
CS_EXPORT void cs_stack_free(CsPicture*);

// image: H x W x 4, blurred where the goal is, and misfit: H x W, written.
CS_EXPORT void cs_stack_picture(const CsPicture*, double* image, double* misfit);

// out: height x width, the uppermost layer that covers so much, more than nothing, of each pixel of a window with its
// corner at (left, top), on the canvas; -1 for none.
CS_EXPORT void cs_stack_uppermost(const CsPicture*, int64_t left, int64_t top, int64_t width, int64_t height,
                                  double least, int32_t* out);

// The sum of the misfit, and of what shows of the background where it may not.
CS_EXPORT double cs_stack_cost(const CsPicture*);

// How many crossings there are; these, written, where `out` is not null. -1 where there is no memory.
CS_EXPORT int64_t cs_stack_crossings(const CsPicture*, const CsCrossings* out);

// growth: groups, by how much the misfit (leaks: and what shows of the background) grows from `before` to `after` on
// the pixels that the pieces of a group change in either picture, px around those that they cross: `spread`.
// group_before, group_after: of each piece, or -1. Returns 0, or 1 where there is no memory.
CS_EXPORT int32_t cs_stack_growth(const CsPicture* before, const CsPicture* after, const int32_t* group_before,
                                  const int32_t* group_after, int64_t groups, int64_t spread, int64_t leaks,
                                  double* growth);

// changed: groups, whether the picture changes from `before` to `after` by more than `least` at a pixel that a piece of
// the group crosses in `after`.
CS_EXPORT void cs_stack_changed(const CsPicture* before, const CsPicture* after, const int32_t* group, double least,
                                uint8_t* changed);

// The damped Gauss-Newton step of some variables, the gradient of half of the cost, by how many px at most each
// outline's control points move, and the misfit of the pixels that it crosses, with `chance` for each. Returns 0, or 1
// where there is no memory.
CS_EXPORT int32_t cs_stack_step(const CsPicture*, const CsUnknowns*, double chance, double* step, double* gradient,
                                double* moves, double* misfits);
}
