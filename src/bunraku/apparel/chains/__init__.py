"""Chains of links that swing: hair, skirts, capes, sleeves, tails, ears and ribbons."""
