"""Networks of torch as `bunraku` runs them."""
