"""The look of a synthetic place: what stands on its plots, and how it is drawn on a given day."""
