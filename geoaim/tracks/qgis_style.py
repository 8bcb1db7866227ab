"""The style by which QGIS shows a layer of states: an arrow for each agent, played by the date."""

from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

from geoaim.tracks.agent_types import get_colour

HEAD = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
FROM_FIELD = "1"  # QGIS's mode in which a field holds the moment of a feature
EXPRESSION = 3  # QGIS's kind of property that an expression computes
# QGIS turns clockwise from north, headings turn counterclockwise from east; lengths are in metres
PROPERTIES = {"angle": '90 - degrees("heading")', "size": '"length"'}


def make_qml(types: Sequence[str], clock: str, step: float) -> str:
    """Make a style of QGIS (QML) for points of states.

    Args:
        types: the types of agents that there are.
        clock: the column of dates.
        step: seconds for which a state is shown.

    Returns:
        The document, for the column `styleQML` of the table `layer_styles`.
    """
    root = ElementTree.Element("qgis", version="3.22.0", styleCategories="Symbology|Temporal")
    temporal = {"enabled": "1", "mode": FROM_FIELD, "startField": clock, "durationUnit": "ms"}
    ElementTree.SubElement(root, "temporal", temporal, fixedDuration=f"{step * 1000:.0f}")
    kind = {"type": "categorizedSymbol", "attr": "type"}
    renderer = ElementTree.SubElement(root, "renderer-v2", kind)
    categories = ElementTree.SubElement(renderer, "categories")
    symbols = ElementTree.SubElement(renderer, "symbols")
    for number, name in enumerate(sorted(set(types))):
        category = {"value": name, "label": name, "symbol": str(number), "render": "true"}
        ElementTree.SubElement(categories, "category", category)
        _add_symbol(symbols, str(number), get_colour(name))
    return HEAD + ElementTree.tostring(root, encoding="unicode")


def _add_symbol(
    symbols: ElementTree.Element, number: str, colour: tuple[float, float, float]
) -> None:
    symbol = ElementTree.SubElement(symbols, "symbol", type="marker", name=number, alpha="1")
    marker = {"class": "SimpleMarker", "enabled": "1", "locked": "0", "pass": "0"}
    layer = ElementTree.SubElement(symbol, "layer", marker)
    rgba = ",".join(str(round(255 * part)) for part in (*colour, 1.0))
    _add_option(
        layer, None, {"name": "arrow", "color": rgba, "size": "4.5", "size_unit": "MapUnit"}
    )
    properties = {
        name: {"active": True, "expression": text, "type": EXPRESSION}
        for name, text in PROPERTIES.items()
    }
    defined = ElementTree.SubElement(layer, "data_defined_properties")
    _add_option(defined, None, {"name": "", "properties": properties, "type": "collection"})


def _add_option(parent: ElementTree.Element, name: str | None, value: Any) -> None:
    """Add a value, or a map of values, as QGIS writes them."""
    names = {} if name is None else {"name": name}
    if isinstance(value, dict):
        option = ElementTree.SubElement(parent, "Option", names, type="Map")
        for key, one in value.items():
            _add_option(option, key, one)
        return
    kind = {bool: "bool", int: "int", str: "QString"}[type(value)]
    text = str(value).lower() if isinstance(value, bool) else str(value)
    ElementTree.SubElement(parent, "Option", names, type=kind, value=text)
