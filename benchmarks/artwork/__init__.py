"""Scores of drawings whose vector truth is known: drawn as pictures, vectorized by several tools, and compared."""
