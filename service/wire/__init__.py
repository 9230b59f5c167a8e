"""The wire contract: what requests and answers look like, and how they become columns."""
