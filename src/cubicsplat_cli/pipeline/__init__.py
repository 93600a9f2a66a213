"""picture -> style -> fit or drawing -> SVG -> independent render -> figures: the whole way for one picture, and the
only one there is.

Writes no files but by `Result.save`: the library and the jobs of the command say where results go.
"""

from cubicsplat_cli.pipeline.measure import measured, timed
from cubicsplat_cli.pipeline.task import Result
from cubicsplat_cli.pipeline.vectorize import candidates, task_of, vectorize_picture

__all__ = ["Result", "candidates", "measured", "task_of", "timed", "vectorize_picture"]
