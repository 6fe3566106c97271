// Bundles the viewer into dist/: the worker that receives and decodes, the page, and the two WASM modules they load.
// Run after `npm ci` and `python web/wasm/build.py`. Every output is one file without imports.
import { copyFileSync, existsSync, mkdirSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const out = join(here, "dist");
mkdirSync(out, { recursive: true });

const entries = { worker: "src/worker.ts", page: "src/page/main.ts", gallery: "src/page/gallery.ts" };
const present = Object.fromEntries(Object.entries(entries).filter(([, path]) => existsSync(join(here, path))));

await build({
  absWorkingDir: here,
  entryPoints: present,
  outdir: "dist",
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  platform: "browser",
  loader: { ".wgsl": "text" },
  external: ["node:fs", "node:path", "fs", "path"], // named in draco3d's glue, for Node alone
  legalComments: "linked",
  logLevel: "warning",
});

const draco = createRequire(import.meta.url).resolve("draco3d/draco_decoder.wasm");
copyFileSync(draco, join(out, "draco_decoder.wasm"));
for (const name of ["index.html", "gallery.html", "icon.svg"]) copyFileSync(join(here, "src/page", name), join(out, name));
if (!existsSync(join(out, "kernels.wasm"))) {
  console.error("dist/kernels.wasm is missing; run: python web/wasm/build.py");
  process.exitCode = 1;
}

// servers hand these out to whoever takes them
for (const name of readdirSync(out)) {
  if (/\.(html|js|css|svg|wasm)$/.test(name)) writeFileSync(join(out, `${name}.gz`), gzipSync(readFileSync(join(out, name)), { level: 9 }));
}
