"""Objects of a shaded picture: where they are, their clean outlines, what shows of them, and their base paints."""
