"""picture -> style -> fit or drawing -> SVG -> independent render -> figures, for one picture.

Writes no files but by `Result.save`: the library and the jobs of the command say where results go.
"""
