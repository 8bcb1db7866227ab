"""The plan of a synthetic place: approaches, lanes, paving, markings, car park, and its HD map."""
