"""An endless supply of captioned household objects made of splats, a function of (seed, index)."""
