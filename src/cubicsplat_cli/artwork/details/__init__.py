"""Details that a finished drawing has lost, found where it does not explain its picture."""
