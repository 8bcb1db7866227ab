/** The address of the page restores the view: place, zoom, turn, time, agent and layers. */

/** Write the view into the address. */
export function writeLink({ view, timeline, state }, hidden) {
  const values = new URLSearchParams();
  const [x, y] = view.getCenter();
  values.set("x", x.toFixed(2));
  values.set("y", y.toFixed(2));
  values.set("resolution", view.getResolution().toPrecision(5));
  if (view.getRotation()) values.set("rotation", view.getRotation().toFixed(4));
  if (timeline) values.set("time", timeline.time.toFixed(2));
  if (state.selected) values.set("agent", state.selected.id);
  if (state.follow) values.set("follow", "1");
  if (state.colouring !== "type") values.set("colour", state.colouring);
  if (hidden.size) values.set("hidden", [...hidden].join(","));
  history.replaceState(null, "", `#${values}`);
}

/** Restore the view from the part of the address after #. */
export function readLink(app, hash) {
  const values = new URLSearchParams(hash.slice(1));
  if (!values.has("x")) return;
  const { view, timeline } = app;
  const hidden = values.get("hidden")?.split(",") ?? [];
  for (const [name, show] of Object.entries(app.layers)) show(!hidden.includes(name));
  if (values.get("colour") === "speed") app.colour?.("speed");
  if (timeline && values.has("time")) timeline.set(Number(values.get("time")));
  if (values.has("agent")) app.select(values.get("agent"));
  view.setCenter([Number(values.get("x")), Number(values.get("y"))]);
  view.setResolution(Number(values.get("resolution")));
  view.setRotation(Number(values.get("rotation") ?? 0));
  if (values.has("follow")) app.follow(true);
}
