// Bundles the page's code into the package, beside its document and style sheet, where it is committed: whoever installs boxlift needs no Node.js.
// The first line holds the digest of the sources, which a test compares.
import { createHash } from "node:crypto";
import { readdirSync, readFileSync } from "node:fs";
import { build } from "esbuild";

const out = "../boxlift_service/review/static";
const digest = createHash("sha256");
for (const name of readdirSync("src").sort()) digest.update(name + "\n").update(readFileSync(`src/${name}`));
digest.update(readFileSync("package-lock.json"));

await build({
  entryPoints: ["src/main.ts"],
  outfile: `${out}/page.js`,
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  legalComments: "inline",
  charset: "ascii",
  banner: { js: `// sources ${digest.digest("hex")}` },
});
