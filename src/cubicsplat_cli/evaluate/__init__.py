"""Quality of the SVG file: drawn by an independent renderer and compared by standard metrics."""
