"""Deterministic and Bayesian updating of jacket finite-element models from ambient vibration."""

__version__ = "0.1.0"
