"""Measurements against the budgets of the design, one script each: python -m benchmarks.NAME."""
