"""Experiments: what the documents behind this project claim, seen with one command each."""
