"""picture -> style -> fit or drawing -> SVG -> independent render -> figures, for one picture.

Writes no files but by `Result.save`: the library and the jobs of the command say where results go.
"""

from cubicsplat_cli.pipeline.choose import candidates
from cubicsplat_cli.pipeline.task import Result
from cubicsplat_cli.pipeline.vectorize import measured, output_of, report_of, task_of, vectorize_picture

__all__ = ["Result", "candidates", "measured", "output_of", "report_of", "task_of", "vectorize_picture"]
