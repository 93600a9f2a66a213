"""Everything that touches a disk: pictures from hostile files, the names of results, whole files or none."""
