"""Translucent shapes: several regions that one shape of even opacity makes of what lies beneath it."""
