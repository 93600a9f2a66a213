"""The drawing that a fit begins with: one of ours, or any other SVG as near as it comes to a scene."""

from cubicsplat_cli.beginning.load import Beginning, load_beginning

__all__ = ["Beginning", "load_beginning"]
