"""What people say: ranks of a blind study (TapMo, Table 3)."""
