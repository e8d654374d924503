"""From noise to motion: steps, solvers, guidance, and windows over long motions."""
