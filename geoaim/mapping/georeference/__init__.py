"""Where the reference frame lies in the world."""
