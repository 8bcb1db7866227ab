"""Control points picked by hand: feedback while picking, snapping, proposals, and saving."""
