"""Benchmarks: speed against accuracy, and where methods break; one script per question."""
