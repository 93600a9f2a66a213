"""Regularities that an artist made on purpose: coordinates on a grid, mirrored shapes, repeated ones."""
