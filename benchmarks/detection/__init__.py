"""The detector of vehicles: drawn pictures, training, judging."""
