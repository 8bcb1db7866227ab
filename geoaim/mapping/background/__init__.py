"""The ground without its traffic: a mean of the registered frames."""
