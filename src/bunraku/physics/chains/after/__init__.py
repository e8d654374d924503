"""What becomes of chains after they were simulated: out of the body, over legs, as one sheet, and not torn."""
