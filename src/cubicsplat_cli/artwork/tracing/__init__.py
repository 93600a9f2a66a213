"""From the borders between inks to outlines: points, corners, the fewest lines and cubics, primitives."""
