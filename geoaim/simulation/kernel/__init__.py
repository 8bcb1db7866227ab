"""The renderer for CPUs, as loops compiled by numba: the pictures that torch draws, faster.

`rasterization`, `coverage` and `compositing` draw the same with torch alone, for GPUs and machines
without numba, and as the reference in tests.
"""
