"""Backgrounds against other methods, with standing queues."""
