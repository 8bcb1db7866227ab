/** Small helpers to make HTML elements. */

/** Make an element with properties and children: make("button", {title: "Play"}, "▶"). */
export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  const { dataset, ...rest } = properties;
  Object.assign(element, rest);
  Object.assign(element.dataset, dataset);
  element.append(...children);
  return element;
}

/** Make the legend of a range of colours: {from, to, unit, colours}. */
export function makeLegend({ from, to, unit, colours }) {
  const style = `background:linear-gradient(to right, ${colours.join(", ")})`;
  return make("small", { className: "legend" }, String(from), make("i", { style }), `${to} ${unit}`);
}

/** Write a length in metres: to the centimetre, and nothing finer. */
export function formatMetres(value) {
  return value < 0.01 ? "under 1 cm" : `${value.toFixed(2)} m`;
}

/** Write a speed in m/s, and in km/h. */
export function formatSpeed(speed) {
  return `${speed.toFixed(1)} m/s (${(3.6 * speed).toFixed(0)} km/h)`;
}

/** Save a text as a file of the browser. */
export function saveText(name, text) {
  const link = make("a", { href: URL.createObjectURL(new Blob([text])), download: name });
  link.click();
  URL.revokeObjectURL(link.href);
}

/** Make a labelled checkbox that calls `change` with its state. */
export function makeCheckbox(label, checked, change, swatch = null) {
  const input = make("input", { type: "checkbox", checked });
  input.addEventListener("change", () => change(input.checked));
  const colour = swatch ? [make("i", { className: "swatch", style: `background:${swatch}` })] : [];
  return make("label", {}, input, ...colour, label);
}
