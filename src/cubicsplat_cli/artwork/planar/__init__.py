"""Planar maps of drawings: what shows of each shape, as regions that abut and share their edges."""
