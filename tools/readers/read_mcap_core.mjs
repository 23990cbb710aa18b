// Reads a recording with @mcap/core (indexed, checksums verified) and decodes it by the schema that it carries, with
// @foxglove/rosmsg and @foxglove/rosmsg2-serialization. Prints what `facts.py` describes, as JSON.
import { createHash } from "node:crypto";
import { open } from "node:fs/promises";
import { createRequire } from "node:module";
import path from "node:path";

const require = createRequire(path.join(process.env.READERS_MODULES ?? process.cwd(), "x.js"));
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

const ROW_TOPIC = "/fffo_drive/row";
const RECORD_TOPIC = "/fffo_drive/records";
const digest = (bytes) => createHash("sha256").update(bytes).digest("hex");

class FileReadable {
  constructor(handle) {
    this.handle = handle;
  }
  async size() {
    return BigInt((await this.handle.stat()).size);
  }
  async read(offset, size) {
    const buffer = new Uint8Array(Number(size));
    const { bytesRead } = await this.handle.read(buffer, 0, Number(size), Number(offset));
    if (bytesRead !== Number(size)) {
      throw new Error(`read ${bytesRead} of ${size} bytes at ${offset}`);
    }
    return buffer;
  }
}

// little-endian bytes of a column: float64, or integers modulo 2^64
function columnFacts(values, float) {
  const bytes = Buffer.alloc(values.length * 8);
  values.forEach((value, row) => {
    if (float) {
      bytes.writeDoubleLE(Number.isNaN(value) ? NaN : value, row * 8);
    } else {
      bytes.writeBigUInt64LE(BigInt.asUintN(64, BigInt(value)), row * 8);
    }
  });
  return {
    first: bytes.subarray(0, 8).toString("hex"),
    last: bytes.subarray(-8).toString("hex"),
    sha256: digest(bytes),
  };
}

const handle = await open(process.argv[2], "r");
const decompressHandlers = await loadDecompressHandlers();
const reader = await McapIndexedReader.Initialize({ readable: new FileReadable(handle), decompressHandlers });

const decoders = new Map();
const definitions = new Map();
for (const channel of reader.channelsById.values()) {
  const schema = reader.schemasById.get(channel.schemaId);
  const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
  decoders.set(channel.id, new MessageReader(definition));
  definitions.set(channel.topic, definition);
}

const columns = new Map();
const logTimes = [];
const events = [];
const recordValues = [];
let records = 0;
let recordLast = [];
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const decoded = decoders.get(message.channelId).readMessage(message.data);
  const topic = reader.channelsById.get(message.channelId).topic;
  if (topic === ROW_TOPIC) {
    logTimes.push(message.logTime);
    for (const [name, value] of Object.entries(decoded)) {
      columns.get(name)?.push(value) ?? columns.set(name, [value]);
    }
  } else if (topic === RECORD_TOPIC) {
    const { time_ns, sequence, number, kind, names, values, data } = decoded;
    records += 1;
    recordValues.push(...values);
    recordLast = [String(time_ns), String(sequence), String(number), kind, ...names, data];
  } else {
    const { time_ns, level, source, text, data } = decoded;
    events.push([String(time_ns), String(level), source, text, data]);
  }
}

const attachments = {};
for await (const attachment of reader.readAttachments()) {
  const { name, mediaType, data } = attachment;
  attachments[name] = [mediaType, data.byteLength, digest(data)];
}
const metadata = {};
for await (const entry of reader.readMetadata()) {
  metadata[entry.name] = Object.fromEntries(entry.metadata);
}

const types = new Map(definitions.get(ROW_TOPIC)[0].definitions.map((field) => [field.name, field.type]));
console.log(
  JSON.stringify({
    rows: logTimes.length,
    columns: Object.fromEntries(
      [...columns].map(([name, values]) => [name, columnFacts(values, types.get(name).startsWith("float"))]),
    ),
    log_time_ns: columnFacts(logTimes, false),
    events: events.length,
    event_first: events[0],
    event_last: events.at(-1),
    records,
    record_last: recordLast,
    record_values: columnFacts(recordValues, true),
    attachments,
    metadata,
  }),
);
await handle.close();
