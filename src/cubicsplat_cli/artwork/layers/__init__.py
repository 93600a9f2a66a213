"""What lies over what, how far each layer reaches, and how its outline goes on where it is hidden."""
