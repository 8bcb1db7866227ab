// Bundles src/ and OpenLayers into geoaim.js, and collects their licences. `npm ci && npm run build`
import { createHash } from "node:crypto";
import { existsSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

// names and contents of the sources; tests compare it with the first line of the bundle
const names = [...readdirSync("src").sort().map((name) => `src/${name}`), "../base/page.css", "build.mjs", "package-lock.json"];
const hash = createHash("sha256");
for (const name of names) hash.update(`${name}\n`).update(readFileSync(name, "utf8").replaceAll("\r\n", "\n"));

const result = await build({
  entryPoints: ["src/index.js"],
  outfile: "geoaim.js",
  bundle: true,
  format: "esm",
  minify: true,
  legalComments: "none",
  target: "es2022",
  loader: { ".css": "text" },
  banner: { js: `// sources: ${hash.digest("hex")}; licences: LICENCES.txt` },
  metafile: true,
});

const bundled = Object.keys(result.metafile.inputs).map((path) => path.match(/node_modules\/((?:@[^/]+\/)?[^/]+)/)?.[1]);
const licences = [...new Set(bundled.filter(Boolean))].sort().map((name) => {
  const { version, license } = JSON.parse(readFileSync(`node_modules/${name}/package.json`, "utf8"));
  const file = ["LICENSE", "LICENSE.md", "LICENSE.txt"].map((x) => `node_modules/${name}/${x}`).find(existsSync);
  return `${name} ${version} (${license})\n\n${readFileSync(file, "utf8").trim()}\n`;
});
writeFileSync("LICENCES.txt", licences.join(`\n${"-".repeat(80)}\n\n`));
