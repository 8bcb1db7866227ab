"""Transform models on simulated control points."""
