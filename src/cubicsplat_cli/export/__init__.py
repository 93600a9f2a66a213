"""SVGs as files for other programs: PDF, PS, EPS, DXF and Android's VectorDrawable."""
