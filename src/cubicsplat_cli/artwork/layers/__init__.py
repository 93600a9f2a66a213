"""The order of layers, how far each reaches, and how its outline goes on where it is hidden."""
