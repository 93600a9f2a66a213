"""Objects of a shaded picture: where they are, their clean outlines and base paints, and what clips their shading."""
