"""Routes: translation between HTTP and the engine, nothing else."""
