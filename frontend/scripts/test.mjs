// Runs tests/*.test.ts with Node's own test runner. Vite bundles them first, because Node 20 cannot read TypeScript.
import { spawnSync } from "node:child_process";
import { readdir } from "node:fs/promises";
import { basename } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "vite";

const pathOf = (relative) => fileURLToPath(new URL(relative, import.meta.url));
const tests = (await readdir(pathOf("../tests"))).filter((name) => name.endsWith(".test.ts"));
const bundles = pathOf("../../build/dashboard-tests");

await build({
  root: pathOf(".."),
  logLevel: "warn",
  publicDir: false,
  build: {
    ssr: true,
    outDir: bundles,
    emptyOutDir: true,
    sourcemap: true,
    rolldownOptions: {
      input: tests.map((name) => pathOf(`../tests/${name}`)),
      output: { entryFileNames: "[name].mjs", chunkFileNames: "[name]-[hash].mjs" },
    },
  },
});
const files = tests.map((name) => `${bundles}/${basename(name, ".ts")}.mjs`);
const options = ["--enable-source-maps", "--test", "--test-reporter=spec"];
const { status } = spawnSync(process.execPath, [...options, ...files], { stdio: "inherit" });
process.exitCode = status ?? 1;
