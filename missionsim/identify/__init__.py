"""Identification of missing physical effects from measured runs: arrays in, findings out (docs/method.md).

The model is ``y = P0(θ) + N ν + Φ β + Z u + ε``. `missionsim.identify.rules` holds the gates and demotions in their
order, `missionsim.identify.verdict` sets the verdict, `missionsim.identify.settings` has every constant with its why.
"""
