"""HD maps: lanelet2 files read, their drivable area, and maps drawn from them."""
