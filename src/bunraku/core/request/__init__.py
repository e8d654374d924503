"""What every request has: limits of numbers, a JSON form that is read strictly, constraints with a kind."""
