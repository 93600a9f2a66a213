"""picture -> style -> fit or drawing -> SVG -> independent render -> figures, for one picture.

Only `Result.save` writes files here; the library and the command's jobs choose where results go.
"""
