"""Networks and what trains on them, in torch: each is defined here once, and `bunraku` runs it without torch."""
