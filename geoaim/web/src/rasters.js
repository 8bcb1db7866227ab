/** Rasters as layers of tiles. */
import TileLayer from "ol/layer/Tile.js";
import TileImage from "ol/source/TileImage.js";
import TileGrid from "ol/tilegrid/TileGrid.js";

const TILE_ERROR = 3; // ol/TileState.ERROR

/** Make the layer of a raster (an item of `rasters` in the description). */
export function makeRasterLayer(raster, transport, projection) {
  const layer = new TileLayer({ visible: raster.visible, opacity: raster.opacity });
  placeRaster(layer, raster, transport, projection);
  return layer;
}

/** Put the tiles of a raster where it lies, moved by metres east and north. */
export function placeRaster(layer, raster, transport, projection, [east, north] = [0, 0]) {
  const { path, resolutions, tile_px: tileSize } = raster;
  const extent = raster.extent.map((value, index) => value + (index % 2 ? north : east));
  const tileGrid = new TileGrid({ extent, origin: [extent[0], extent[3]], resolutions, tileSize });
  const source = new TileImage({
    projection,
    tileGrid,
    transition: 0,
    tileUrlFunction: ([level, column, row]) => `${path}/${level}/${column}/${row}`,
    tileLoadFunction: async (tile, address) => {
      const image = tile.getImage();
      try {
        const url = URL.createObjectURL(new Blob([await transport.read(address)]));
        image.addEventListener("load", () => URL.revokeObjectURL(url), { once: true });
        image.src = url;
      } catch {
        tile.setState(TILE_ERROR);
      }
    },
  });
  layer.setExtent(extent);
  layer.setSource(source);
}
