"""Where colours change evenly: which gradient they follow, and the picture with flat inks in their place."""
