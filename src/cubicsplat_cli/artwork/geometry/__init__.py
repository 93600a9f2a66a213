"""Outlines and pen strokes of artwork, their fit to points, and how finely they are followed."""
