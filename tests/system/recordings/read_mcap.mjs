// Reads MCAP files with the official TypeScript reader and prints what it finds, one JSON object a file.
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";

const decompressHandlers = await loadDecompressHandlers();
for (const path of process.argv.slice(2)) {
  const file = await open(path, "r");
  const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file), decompressHandlers });
  const counts = {};
  let bytes = 0;
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    const channel = reader.channelsById.get(message.channelId);
    counts[channel.topic] = (counts[channel.topic] ?? 0) + 1;
    bytes += message.data.byteLength;
  }
  const metadata = {};
  for await (const record of reader.readMetadata()) {
    metadata[record.name] = Object.fromEntries(record.metadata);
  }
  const attachments = {};
  for await (const attachment of reader.readAttachments()) {
    attachments[attachment.name] = attachment.data.byteLength;
  }
  console.log(JSON.stringify({ path, counts, bytes, metadata, attachments }));
  await file.close();
}
