//! Builds the two bundles that the programs embed: the live page, and the player of reports.
//!
//!     node build.mjs                     writes both
//!     node build.mjs --check [CRATES]    fails unless the files in the repository, whose folder of crates is CRATES, are what this build makes

import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { resolve } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";
import { build } from "esbuild";
import { gzipSync } from "fflate";
import { slim } from "./slim.mjs";

const folder = fileURLToPath(new URL(".", import.meta.url));
const isCheck = process.argv[2] === "--check";
const crates = pathToFileURL(`${resolve(process.argv[3] ?? fileURLToPath(new URL("../..", import.meta.url)))}/`);
const VIEW = new URL("opspace-live/src/page/view.html", crates);
const PLAYER = new URL("opspace-report/src/player/player.js.gz", crates);
const PLAYER_HASH = new URL("opspace-report/src/player/player.js.sha256", crates);

/** Imports the bundle of a worker as text: the page is one file. */
const worker = {
  name: "worker",
  setup({ onResolve, onLoad }) {
    onResolve({ filter: /^worker:/ }, ({ path, resolveDir }) => ({ path: resolve(resolveDir, path.slice(7)), namespace: "worker" }));
    onLoad({ filter: /./, namespace: "worker" }, async ({ path }) => {
      const { outputFiles } = await build({ entryPoints: [path], bundle: true, minify: true, write: false, target: "es2022" });
      return { contents: outputFiles[0].text, loader: "text" };
    });
  },
};

/** One script of an entry and all that it imports. */
async function script(entry) {
  const { outputFiles } = await build({
    absWorkingDir: folder,
    entryPoints: [`src/${entry}`],
    bundle: true,
    minify: true,
    write: false,
    format: "iife",
    target: "es2022",
    charset: "utf8",
    // Licences of libraries stay in what is delivered.
    legalComments: "eof",
    plugins: [slim, worker],
  });
  // A script ends at `</script` wherever it is written.
  return outputFiles[0].text.replaceAll("</script", "<\\/script");
}

const player = Buffer.from(await script("player.ts"));
const html = readFileSync(new URL("src/view.html", import.meta.url), "utf8");
const css = readFileSync(new URL("src/view.css", import.meta.url), "utf8");
const view = await script("view.ts");
const page = html
  .replace("<!-- style -->", () => `<style>\n${css}</style>`)
  .replace("<!-- script -->", () => `<script>${view}</script>`);
const files = [
  [VIEW, Buffer.from(page)],
  // Compressed by a library in JavaScript: the bytes are the same on every machine. Its header has no time.
  [PLAYER, Buffer.from(gzipSync(player, { level: 9, mem: 12, mtime: 0 }))],
  // The page allows scripts by their hashes.
  [PLAYER_HASH, Buffer.from(createHash("sha256").update(player).digest("base64"))],
];
let different = 0;
for (const [url, bytes] of files) {
  if (isCheck) {
    if (readFileSync(url).equals(bytes)) continue;
    different += 1;
    console.error(`${url.pathname} is not what this build makes: npm run build`);
  } else {
    mkdirSync(new URL(".", url), { recursive: true });
    writeFileSync(url, bytes);
    console.log(`${bytes.length} bytes  ${url.pathname}`);
  }
}
process.exitCode = different > 0 ? 1 : 0;
