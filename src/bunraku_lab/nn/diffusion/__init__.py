"""The networks of Shape-aware Motion Diffusion (section 3.2 of TapMo)."""
