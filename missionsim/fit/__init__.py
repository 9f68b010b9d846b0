"""Fitting base models and parameters to logs."""
