// The page of the studio. It takes three.js from the built view (vite.view.config.js), so that it is shipped once. Names without hashes, so that a build gives the same files, and the licences of what is in it.
import { readFileSync, readdirSync } from "node:fs";
import { defineConfig } from "vite";

const INSIDE = ["three", "preact", "@preact/signals", "@preact/signals-core", "fflate", "@fontsource-variable/figtree"];

function licences() {
  return {
    name: "licences",
    generateBundle() {
      const parts = INSIDE.map((name) => {
        const folder = new URL(`node_modules/${name}/`, import.meta.url);
        const { version, license } = JSON.parse(readFileSync(new URL("package.json", folder), "utf8"));
        const file = readdirSync(folder).find((one) => /^licen[cs]e/i.test(one));
        const text = file ? readFileSync(new URL(file, folder), "utf8").trim() : `License: ${license}`;
        return `${name} ${version}\n\n${text}\n`;
      });
      this.emitFile({ type: "asset", fileName: "LICENSES.txt", source: parts.join(`\n${"-".repeat(80)}\n\n`) });
    },
  };
}

/** In what is built, three.js is what view.js exports. */
function threeFromTheView() {
  return {
    name: "three-from-the-view",
    apply: "build",
    enforce: "pre",
    resolveId(source) {
      return source === "three" || source.startsWith("three/") ? { id: "./view.js", external: true } : null;
    },
  };
}

export default defineConfig({
  base: "./",
  plugins: [threeFromTheView(), licences()],
  test: { environment: "happy-dom", include: ["tests/*.test.ts", "tests/*.test.tsx"] },
  build: {
    outDir: "../src/bunraku/studio/static",
    emptyOutDir: true,
    target: "es2022",
    modulePreload: false,
    chunkSizeWarningLimit: 900,
    rolldownOptions: {
      output: {
        entryFileNames: "studio.js",
        chunkFileNames: "[name].js",
        assetFileNames: "[name][extname]",
      },
    },
  },
});
