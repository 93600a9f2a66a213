"""Moving pictures: curves that follow the frames of a clip along piecewise linear paths."""

from cubicsplat_cli.motion.fitting import fit_clip

__all__ = ["fit_clip"]
