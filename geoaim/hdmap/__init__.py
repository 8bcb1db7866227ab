"""HD maps: lanelet2 files, their drivable areas, and images drawn from them."""
