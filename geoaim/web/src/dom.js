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

/** Make a labelled checkbox that calls `change` with its state. */
export function makeCheckbox(label, checked, change, swatch = null) {
  const input = make("input", { type: "checkbox", checked });
  input.addEventListener("change", () => change(input.checked));
  const colour = swatch ? [make("i", { className: "swatch", style: `background:${swatch}` })] : [];
  return make("label", {}, input, ...colour, label);
}
