"""Where events are kept: the journal's contract, its encoding and its stores."""
