"""Mutants: whether the quick tests notice a wrong constant, sign or comparison."""
