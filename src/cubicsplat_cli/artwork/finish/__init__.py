"""The finish: all parameters of a drawing together against its pixels; moves that add or tie some; further shapes."""
