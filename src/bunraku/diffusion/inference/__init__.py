"""The networks of Shape-aware Motion Diffusion, as they run: in numpy, whatever their config says."""
