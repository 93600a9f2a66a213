"""Areas of evenly changing colour: the gradient that each follows, and the picture with flat fills in their place."""
