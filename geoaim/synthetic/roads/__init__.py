"""The plan of a made place: arms, lanes, paving, markings, car park, and the HD map of them."""
