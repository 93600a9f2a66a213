"""Moving pictures: curves that follow the frames of a clip along piecewise linear paths."""
