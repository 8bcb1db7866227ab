"""Where imagery lies: its correction from tracks, from an AIM, or from control points."""
