"""HTML reports: how good an SVG is, curve by curve, in one file that needs nothing else."""
