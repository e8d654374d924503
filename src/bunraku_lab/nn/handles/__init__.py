"""The networks of handles and orientation (section 3.1 of TapMo)."""
