/** A map of a picture in its pixels, with markers that can be dragged. */
import Feature from "ol/Feature.js";
import Point from "ol/geom/Point.js";
import Polygon from "ol/geom/Polygon.js";
import { defaults as defaultInteractions } from "ol/interaction/defaults.js";
import Translate from "ol/interaction/Translate.js";
import ImageLayer from "ol/layer/Image.js";
import VectorLayer from "ol/layer/Vector.js";
import Map from "ol/Map.js";
import Static from "ol/source/ImageStatic.js";
import VectorSource from "ol/source/Vector.js";
import { Fill, Stroke, Style, Text } from "ol/style.js";
import CircleStyle from "ol/style/Circle.js";
import { addLens } from "./lens.js";
import { makeMapView } from "./map_view.js";
import { makeRasterLayer } from "./rasters.js";

const MARGIN_PX = 20;
const COLOURS = { used: "#ff6a00", wrong: "#c1121f", incomplete: "#ffd400", candidate: "#39ff14", next: "#00c2ff" };

// pixels have v down, maps have y up
const toMap = ([u, v]) => [u, -v];
const toPixel = ([x, y]) => [x, -y];

function makeStyle(feature) {
  const { kind, name, selected } = feature.getProperties();
  const colour = COLOURS[kind];
  if (kind === "ellipse") return new Style({ stroke: new Stroke({ color: "#ffffff", width: 2, lineDash: [4, 4] }) });
  const hollow = kind === "next";
  return new Style({
    image: new CircleStyle({
      radius: kind === "next" ? 16 : selected ? 8 : 6,
      stroke: new Stroke({ color: colour, width: selected ? 3 : 2, lineDash: hollow ? [4, 4] : undefined }),
      fill: new Fill({ color: kind === "candidate" ? "rgba(57,255,20,0.35)" : "rgba(0,0,0,0.01)" }),
    }),
    text: name
      ? new Text({
          text: name,
          offsetX: 10,
          offsetY: -10,
          textAlign: "left",
          fill: new Fill({ color: "white" }),
          stroke: new Stroke({ color: "black", width: 3 }),
        })
      : undefined,
  });
}

export class PixelMap {
  /** `events`: click(pixel), drag(id, pixel), accept(candidate). */
  constructor(target, raster, transport, events) {
    const view = makeMapView(raster.extent);
    this.features = new VectorSource();
    const markers = new VectorLayer({ source: this.features, style: makeStyle, zIndex: 5 });
    this.overlay = new ImageLayer({ opacity: 0, zIndex: 2 });
    this.map = new Map({
      target,
      view,
      controls: [],
      layers: [makeRasterLayer(raster, transport, view.getProjection()), this.overlay, markers],
      interactions: defaultInteractions({ doubleClickZoom: false }),
    });
    const movable = (feature) => feature.get("id") !== undefined;
    const translate = new Translate({ layers: [markers], filter: movable, hitTolerance: 3 });
    translate.on("translateend", ({ features }) => {
      const [feature] = features.getArray();
      events.drag(feature.get("id"), toPixel(feature.getGeometry().getCoordinates()));
    });
    this.map.addInteraction(translate);
    this.map.on("singleclick", ({ coordinate, pixel }) => {
      const { id, candidate } =
        this.map
          .getFeaturesAtPixel(pixel)
          .map((feature) => feature.getProperties())
          .find((properties) => "id" in properties || "candidate" in properties) ?? {};
      if (id !== undefined) events.select(id);
      else if (candidate !== undefined) events.accept(candidate);
      else events.click(toPixel(coordinate));
    });
    this.extent = raster.extent;
    this.fit();
    addLens(this.map);
  }

  /** Show the whole picture, upright. */
  fit() {
    this.map.updateSize();
    this.map.getView().setRotation(0);
    this.map.getView().fit(this.extent, { padding: Array(4).fill(MARGIN_PX) });
  }

  /** Show markers: {pixel, kind, name, id, candidate, selected}, and rings of pixels. */
  show(markers, rings = []) {
    this.features.clear();
    for (const { pixel, ...properties } of markers) {
      this.features.addFeature(new Feature({ geometry: new Point(toMap(pixel)), ...properties }));
    }
    for (const ring of rings) {
      this.features.addFeature(new Feature({ geometry: new Polygon([ring.map(toMap)]), kind: "ellipse" }));
    }
  }

  /** Lay a picture over the map: {url, extent: [left, top, right, bottom] in pixels}. */
  setOverlay({ url, extent: [left, top, right, bottom] }) {
    const imageExtent = [left, -bottom, right, -top];
    this.overlay.setSource(new Static({ url, imageExtent, projection: this.map.getView().getProjection() }));
  }

  /** Turn the picture on the screen, clockwise in degrees. */
  turn(degrees) {
    this.map.getView().setRotation((degrees * Math.PI) / 180);
  }

  /** How it is turned, in degrees from -180 to 180. */
  getTurn() {
    const degrees = (this.map.getView().getRotation() * 180) / Math.PI;
    return degrees - 360 * Math.round(degrees / 360);
  }

  /** Show the ground that another map shows, as large and turned alike, and a pixel in the middle. */
  follow(other, pixel, { angle, scale }) {
    const [view, theirs] = [this.map.getView(), other.map.getView()];
    view.setCenter(toMap(pixel));
    view.setRotation(theirs.getRotation() + angle);
    view.setResolution(theirs.getResolution() * scale);
  }
}
