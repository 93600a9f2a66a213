"""Outlines and pen strokes of artwork, how finely they are followed, and the exact coverage of pixels by them."""
