from geoaim.tracks.agent_types import AGENT_GROUPS, OTHER, find_group, select_group

TYPES = ("car", "pedestrian", "cyclist", "motorcycle", "bus")


def test_each_agent_belongs_to_one_group():
    masks = [select_group(TYPES, group) for group in (*AGENT_GROUPS, OTHER)]
    assert sum(mask.astype(int) for mask in masks).tolist() == [1] * len(TYPES)


def test_motorcycles_are_in_no_named_group():
    assert find_group("motorcycle") == OTHER
