"""Registration against other methods, and where it breaks."""
