// Validates each JSON message of an MCAP file against the JSON Schema in its channel's metadata, with ajv in strict
// mode. Prints one JSON object: messages by channel, and what is invalid.
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import Ajv2020 from "ajv/dist/2020.js";

const ajv = new Ajv2020.default({ strict: true, allErrors: false });
const validators = new Map();
const decompressHandlers = await loadDecompressHandlers();
const file = await open(process.argv[2], "r");
const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file), decompressHandlers });
const counts = {};
const invalid = [];
const text = new TextDecoder("utf-8", { fatal: true });
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  const schema = channel.metadata.get("json_schema");
  if (schema === undefined) continue;
  if (!validators.has(schema)) validators.set(schema, ajv.compile(JSON.parse(schema)));
  const validate = validators.get(schema);
  counts[channel.topic] = (counts[channel.topic] ?? 0) + 1;
  if (!validate(JSON.parse(text.decode(message.data)))) {
    invalid.push(`${channel.topic}: ${ajv.errorsText(validate.errors)}`);
  }
}
await file.close();
console.log(JSON.stringify({ counts, invalid: invalid.slice(0, 20) }));
