"""Plans: which way, which speed, which control scheme, where to charge, and how sure."""
