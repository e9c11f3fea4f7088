import { createHash } from "node:crypto";
import { existsSync, readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { defineConfig, type Plugin } from "vite";

const SOURCES = ["index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts", "src"];

function files(path: string): string[] {
  if (path !== "src" && !path.startsWith("src/")) return [path];
  const entries = readdirSync(path, { withFileTypes: true });
  return entries.flatMap((entry) => (entry.isDirectory() ? files(`${path}/${entry.name}`) : [`${path}/${entry.name}`]));
}

/** A hash of the sources, so that a test without node detects changed sources without a build. */
function stamp(): Plugin {
  return {
    name: "stamp",
    generateBundle() {
      const hash = createHash("sha256");
      for (const file of SOURCES.flatMap(files).sort()) {
        hash.update(`${file}\n`);
        hash.update(readFileSync(join(import.meta.dirname, file), "utf8").replaceAll("\r\n", "\n"));
      }
      this.emitFile({ type: "asset", fileName: "sources.sha256", source: `${hash.digest("hex")}\n` });
    },
  };
}

/** The licences of the built-in packages, which must accompany them. */
function licences(): Plugin {
  return {
    name: "licences",
    generateBundle() {
      const folders = new Map<string, string>();
      for (const id of this.getModuleIds()) {
        const found = /^(.*\/node_modules\/((?:@[^/]+\/)?[^/]+))\//.exec(id.replaceAll("\\", "/"));
        if (found) folders.set(found[2] as string, found[1] as string);
      }
      const parts = [...folders].sort().map(([name, folder]) => {
        const path = ["LICENSE", "LICENSE.md", "LICENSE.txt", "license"].map((file) => join(folder, file)).find(existsSync);
        if (!path) throw new Error(`${name} has no licence`);
        return `${name}\n\n${readFileSync(path, "utf8").replaceAll("\r\n", "\n").trim()}\n`;
      });
      this.emitFile({ type: "asset", fileName: "licences.txt", source: parts.join(`\n${"-".repeat(80)}\n\n`) });
    },
  };
}

// Fixed file names and no source maps: the server lists the files by name, and the build is the same everywhere.
export default defineConfig({
  base: "./",
  plugins: [stamp(), licences()],
  build: {
    outDir: "../page",
    emptyOutDir: true,
    target: "es2022",
    modulePreload: false,
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 2000,
    rollupOptions: {
      output: {
        entryFileNames: "app.js",
        assetFileNames: "app.[ext]",
        inlineDynamicImports: true,
      },
    },
  },
});
