"""Registration of the frames to a reference frame."""
