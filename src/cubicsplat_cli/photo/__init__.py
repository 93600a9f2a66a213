"""Fitting a scene to a picture: the photo style."""
