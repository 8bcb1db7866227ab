"""The styles by which QGIS shows the layers of a GeoPackage of tracks, as QGIS 3.22 writes them."""

from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

from geoaim.tracks.agent_types import get_colour

DOCUMENT = """<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology|Temporal">
 {temporal}
 <renderer-v2 type="categorizedSymbol" attr="type">
  <categories>{categories}
  </categories>
  <symbols>{symbols}
  </symbols>
 </renderer-v2>
</qgis>
"""
# mode 1: a field holds the moment of a feature
TEMPORAL = '<temporal enabled="1" mode="1" startField="{}" fixedDuration="{}" durationUnit="ms"/>'
CATEGORY = '\n   <category value={name} label={name} symbol="{number}" render="true"/>'
LINE = """
   <symbol type="line" name="{number}" alpha="1">
    <layer class="SimpleLine" enabled="1" locked="0" pass="0">
     <Option type="Map">
      <Option name="line_color" type="QString" value="{rgb},255"/>
     </Option>
    </layer>
   </symbol>"""
# QGIS turns clockwise from north, headings turn counterclockwise from east
ARROW = """
   <symbol type="marker" name="{number}" alpha="1">
    <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
     <Option type="Map">
      <Option name="name" type="QString" value="arrow"/>
      <Option name="color" type="QString" value="{rgb},255"/>
      <Option name="size_unit" type="QString" value="RenderMetersInMapUnits"/>
     </Option>
     <data_defined_properties>
      <Option type="Map">
       <Option name="name" type="QString" value=""/>
       <Option name="properties" type="Map">
        <Option name="angle" type="Map">
         <Option name="active" type="bool" value="true"/>
         <Option name="expression" type="QString" value="90 - degrees(&quot;heading&quot;)"/>
         <Option name="type" type="int" value="3"/>
        </Option>
        <Option name="size" type="Map">
         <Option name="active" type="bool" value="true"/>
         <Option name="expression" type="QString" value="&quot;length&quot;"/>
         <Option name="type" type="int" value="3"/>
        </Option>
       </Option>
       <Option name="type" type="QString" value="collection"/>
      </Option>
     </data_defined_properties>
    </layer>
   </symbol>"""


def make_qml(types: Sequence[str], symbol: str, temporal: str = "") -> str:
    """Make the style of a layer with a symbol for each type of agents.

    Args:
        types: those that there are.
        symbol: `ARROW` or `LINE`.
        temporal: `TEMPORAL` with the column of dates, and the milliseconds that a state lasts.
    """
    categories, symbols = "", ""
    for number, name in enumerate(sorted(set(types))):
        rgb = ",".join(str(round(255 * part)) for part in get_colour(name))
        categories += CATEGORY.format(name=quoteattr(name), number=number)
        symbols += symbol.format(number=number, rgb=rgb)
    return DOCUMENT.format(temporal=temporal, categories=categories, symbols=symbols)
