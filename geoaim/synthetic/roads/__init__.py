"""The plan of a made place: approaches, lanes, paving, markings, car park, and its HD map."""
