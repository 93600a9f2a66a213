"""Pages to look at: how good an SVG is, curve by curve, in one HTML file that needs nothing else."""
