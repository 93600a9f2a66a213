"""The parts of a picture that its finished drawing leaves unexplained, and shapes that explain them."""
