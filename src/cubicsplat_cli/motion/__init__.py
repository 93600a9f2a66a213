"""The fit of curves that move: from the frames of a clip to a `Clip` of moving scenes."""
