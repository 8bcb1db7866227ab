/** Where the viewer gets its data from: a server, a Jupyter kernel, or the page itself. */

/** A local server: GET for data, POST for calls. `base` ends with "/". */
export function serverTransport(base) {
  const check = async (response) => {
    if (!response.ok) throw new Error((await response.text()) || response.statusText);
    return response;
  };
  return {
    address: (path) => base + path, // what a player reads by itself
    read: async (path) => (await check(await fetch(base + path))).arrayBuffer(),
    call: async (action) => {
      const body = JSON.stringify(action);
      const headers = { "Content-Type": "application/json" };
      return (await check(await fetch(base + "call", { method: "POST", headers, body }))).json();
    },
  };
}

/** Data inside an HTML file, as base64 by path; nothing can be called. */
export function embeddedTransport(data) {
  return {
    read: async (path) => {
      if (!(path in data)) throw new Error(`${path} is not in this file`);
      return Uint8Array.from(atob(data[path]), (letter) => letter.charCodeAt(0)).buffer;
    },
    call: null,
  };
}

/** A Jupyter kernel, by the custom messages of an anywidget model. */
export function widgetTransport(model) {
  const waiting = new Map();
  let last = 0;
  model.on("msg:custom", (message, buffers) => {
    const { resolve, reject } = waiting.get(message.id) ?? {};
    if (!resolve) return;
    waiting.delete(message.id);
    if (message.error) return reject(new Error(message.error));
    const view = buffers?.[0];
    // a DataView may be a part of a larger buffer
    resolve(view ? view.buffer.slice(view.byteOffset, view.byteOffset + view.byteLength) : message.reply);
  });
  const ask = (message) =>
    new Promise((resolve, reject) => {
      waiting.set(++last, { resolve, reject });
      model.send({ ...message, id: last });
    });
  return { read: (path) => ask({ path }), call: (action) => ask({ action }) };
}

/** Read JSON at a path. */
export async function readJson(transport, path) {
  return JSON.parse(new TextDecoder().decode(await transport.read(path)));
}
