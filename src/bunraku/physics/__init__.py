"""Physics of apparel: the rigid bodies and springs of MMD and VRM characters, simulated."""
