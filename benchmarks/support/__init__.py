"""Worlds, traffic and figures that several benchmarks share."""
