"""From the borders between fills to outlines: points, corners, the fewest lines and cubics, primitives."""
