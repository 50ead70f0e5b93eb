// Validates the AsyncAPI document on standard input against AsyncAPI's own JSON Schema; prints what is invalid.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import Ajv from "ajv";

const schema = createRequire(import.meta.url)("@asyncapi/specs/schemas/3.0.0-without-$id.json");
// Formats such as `uri` are a package of their own, and the schema is not written for the strict mode.
const ajv = new Ajv.default({ strict: false, allErrors: true, validateFormats: false });
const validate = ajv.compile(schema);
validate(JSON.parse(readFileSync(0, "utf-8")));
console.log(JSON.stringify((validate.errors ?? []).slice(0, 20).map((e) => `${e.instancePath} ${e.message}`)));
