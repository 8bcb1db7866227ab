"""The background: a mean of the registered frames, without traffic."""
