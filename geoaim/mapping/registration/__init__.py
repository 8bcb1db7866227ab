"""Where each frame lies on the reference frame."""
