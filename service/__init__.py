"""The service: everything that touches the world (HTTP, disk, clock, threads)."""
