"""The finish: all parameters of the drawing together against its pixels, and moves that add or tie some."""
