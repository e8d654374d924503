// Prints {file: {errors, messages}} as JSON for the GLB files named as arguments. NODE_PATH says where the validator is.
const fs = require("fs");
const validator = require("gltf-validator");

(async () => {
  const out = {};
  for (const file of process.argv.slice(2)) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), { maxIssues: 1000 });
    const messages = report.issues.messages.map((m) => `${m.severity} ${m.code} ${m.pointer || ""}: ${m.message}`);
    out[file] = { errors: report.issues.numErrors, warnings: report.issues.numWarnings, messages };
  }
  console.log(JSON.stringify(out));
})();
