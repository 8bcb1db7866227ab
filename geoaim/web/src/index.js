/** The viewer as one module: a page of its own, and a Jupyter widget (anywidget). */
import olStyle from "ol/ol.css";
import pageStyle from "../../base/page.css";
import style from "./style.css";
import { make } from "./dom.js";
import { embeddedTransport, readJson, serverTransport, widgetTransport } from "./transport.js";
import { showPicking } from "./pick.js";
import { showView } from "./view.js";

const APPS = { view: showView, pick: showPicking };

/** Show what a transport describes in an element. */
export async function mount(element, transport, options = {}) {
  if (!document.getElementById("geoaim-style")) {
    document.head.append(make("style", { id: "geoaim-style" }, olStyle + pageStyle + style));
  }
  element.classList.add("geoaim");
  try {
    const description = await readJson(transport, "description.json");
    return await APPS[description.kind](element, description, transport, options);
  } catch (error) {
    element.replaceChildren(make("p", { className: "error" }, error.message));
    throw error;
  }
}

function startPage(element) {
  const embedded = document.getElementById("geoaim-data");
  const base = new URL("./", location.href).href.split("#")[0];
  const transport = embedded ? embeddedTransport(JSON.parse(embedded.textContent)) : serverTransport(base);
  if (!embedded) new EventSource(`${base}alive`); // the server stops when its last page is closed
  mount(element, transport, { link: true, keys: document }).then((app) => (window.geoaim = app));
}

const page = document.getElementById("geoaim-page");
if (page) startPage(page);

/** What anywidget calls. */
export default {
  async render({ model, el }) {
    el.style.height = "520px";
    const app = await mount(el, widgetTransport(model));
    return () => app.map?.setTarget(null);
  },
};
