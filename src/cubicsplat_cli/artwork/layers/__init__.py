"""The order of layers, translucent ones too, how far each reaches, and how its outline goes on where it is hidden."""
