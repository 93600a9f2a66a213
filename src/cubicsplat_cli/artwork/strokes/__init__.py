"""Shapes of even width as pen strokes: centre line, width, caps and joins."""
