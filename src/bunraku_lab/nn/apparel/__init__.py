"""The networks of apparel (section 4 of MMDMC)."""
