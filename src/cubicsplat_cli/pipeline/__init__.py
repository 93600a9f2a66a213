"""picture -> style -> fit or drawing -> SVG -> independent render -> figures: the whole way for one picture, and the
only one there is.

Writes no files but by `Result.save`: the library and the jobs of the command say where results go.
"""

from cubicsplat_cli.pipeline.measure import timed
from cubicsplat_cli.pipeline.task import Result
from cubicsplat_cli.pipeline.way import vectorize_picture

__all__ = ["Result", "timed", "vectorize_picture"]
