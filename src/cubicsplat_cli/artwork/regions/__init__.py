"""The regions of a flat picture, and their fills; lines too thin to have an interior."""
