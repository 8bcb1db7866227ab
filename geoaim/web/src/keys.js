/** Shortcuts: keys that work wherever the pointer was last, except in text fields. */

const TEXT_FIELDS = "textarea, select, input:not([type=checkbox], [type=range], [type=button])";

const OWN_KEYS = /^( |Enter|Arrow.*|Home|End|Page.*)$/;

/**
 * Call `act(event)` on keys pressed in `host`; it returns whether it knew the key.
 *
 * A control that was clicked would take Space for itself and toggle again, so it loses the focus
 * then. One that was reached with Tab keeps the keys that it uses itself.
 */
export function addShortcuts(host, element, act) {
  let byPointer = false;
  element.tabIndex = 0;
  host.addEventListener("pointerdown", () => (byPointer = true), true);
  host.addEventListener("keydown", (event) => {
    if (event.key === "Tab") byPointer = false;
    const { target } = event;
    const control = target.matches?.("input, select, button, summary");
    const chord = event.ctrlKey || event.metaKey;
    if (target.matches?.(TEXT_FIELDS) && !(byPointer && target.matches("select"))) return;
    if (control && !byPointer && !chord && (OWN_KEYS.test(event.key) || target.matches("select"))) return;
    if (!act(event)) return;
    event.preventDefault();
    if (control) element.focus({ preventScroll: true });
  });
}
