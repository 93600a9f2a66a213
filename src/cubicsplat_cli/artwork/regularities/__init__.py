"""What an artist made alike on purpose: coordinates on a grid, mirrored shapes, repeated ones."""
