"""What a finished drawing leaves unexplained of its picture, and the shapes that explain it."""
