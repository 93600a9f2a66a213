"""How good artwork is: drawings whose vector truth is known are drawn, vectorized by several tools, and compared."""
