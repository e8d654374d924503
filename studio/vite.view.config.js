// The view of one animation: a single module that pages and notebooks hold, without a server, and that the studio's page loads; and
// three.js's licence.
import { readFileSync } from "node:fs";
import { defineConfig } from "vite";

const licence = {
  name: "licence",
  generateBundle() {
    const source = readFileSync(new URL("node_modules/three/LICENSE", import.meta.url), "utf8");
    this.emitFile({ type: "asset", fileName: "LICENSE-three.txt", source });
  },
};

export default defineConfig({
  publicDir: false,
  plugins: [licence],
  build: {
    outDir: "../src/bunraku/render/view",
    emptyOutDir: false,
    target: "es2022",
    lib: { entry: "src/view.ts", formats: ["es"], fileName: () => "view.js" },
    rolldownOptions: { output: { minify: true } }, // a library's whitespace would stay
  },
});
