"""A simulator of traffic, from tensors to tensors; `geoaim.rendering` draws its views."""

from geoaim.simulation.simulator import collate_scenarios

__all__ = ["collate_scenarios"]
