"""Traffic in a made place: ways, lights, vehicles, people on foot and on cycles."""
