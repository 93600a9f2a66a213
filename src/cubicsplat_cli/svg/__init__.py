"""The SVG side: writing a scene or a drawing as plain SVG 1.1 and reading our own files back."""
