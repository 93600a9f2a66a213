"""The regions of a flat picture, and their inks; lines too thin to have an interior."""
