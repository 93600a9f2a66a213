"""The scene: the curves that fit, raster and svg exchange, in arrays of numpy or torch, and their fills' gradients."""

from cubicsplat_cli.scene.layers import AnyScene, EmbeddedImage, LayeredScene, SceneLayer
from cubicsplat_cli.scene.scene import Scene, pack_rings, points_from_segments, ring_slices, segments_from_points

__all__ = [
    "AnyScene", "EmbeddedImage", "LayeredScene", "Scene", "SceneLayer", "pack_rings", "points_from_segments",
    "ring_slices", "segments_from_points",
]  # fmt: skip
