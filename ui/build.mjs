// Builds the page.
//
// Usage: node build.mjs [FOLDER]; the folder is dist/ if none is given.
// Invariant: the same sources and the same package-lock.json give the same bytes on every machine: no time, no path, no map of
// sources is in them. Must not know: the service.

import { build } from "esbuild";
import { copyFileSync, mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const out = resolve(process.argv[2] ?? join(here, "dist"));
rmSync(out, { recursive: true, force: true });
mkdirSync(out, { recursive: true });

/** What of three.js each file gets. */
const parts = {
  name: "parts of three",
  setup({ onResolve, onLoad }) {
    // The views are a file of their own, which the page fetches after it has begun.
    onResolve({ filter: /\/view\.ts$/ }, ({ kind }) => (kind === "dynamic-import" ? { path: "./view.js", external: true } : null));
    // Loaders of meshes get what they use; see the module.
    onResolve({ filter: /^three$/ }, ({ importer, kind, resolveDir }) => {
      const isLoader = /jsm[\\/]loaders/.test(importer);
      if (kind !== "import-statement") return null;
      return isLoader ? { path: join(here, "src/mesh/three.ts") } : { path: join(here, "node_modules/three/src/Three.js"), sideEffects: false };
    });
    // The views have shaders of their own: those of three.js are left out.
    onLoad({ filter: /three[\\/]src[\\/]renderers[\\/]shaders[\\/].*\.glsl\.js$/ }, () => ({
      contents: 'export const vertex = "", fragment = ""; export default "";',
    }));
  },
};

await build({
  absWorkingDir: here,
  entryPoints: ["src/main.ts", "src/view.ts", "src/worker.ts", "src/style.css"],
  outdir: out,
  bundle: true,
  format: "esm",
  target: ["es2022", "chrome113", "firefox114", "safari16.4"],
  minify: true,
  charset: "utf8",
  legalComments: "none",
  sourcemap: false,
  treeShaking: true,
  plugins: [parts],
  logLevel: "warning",
});
for (const file of ["index.html", "icon.svg"]) copyFileSync(join(here, "src", file), join(out, file));

// What others wrote and is in view.js and worker.js.
const three = join(here, "node_modules", "three");
const { version } = JSON.parse(readFileSync(join(three, "package.json"), "utf8"));
writeFileSync(join(out, "LICENSES.txt"), `three ${version}, https://threejs.org\n\n${readFileSync(join(three, "LICENSE"), "utf8").trim()}\n`);
