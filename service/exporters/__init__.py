"""What leaves a map for people and for other tools."""
