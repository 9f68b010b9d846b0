"""Identification of missing physical effects from measured runs: numeric core (arrays in, findings out)."""
