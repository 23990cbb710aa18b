"use strict";
// Decoding of WebSocket frames, and rows of a capture as CSV: exactly the numbers that the loop wrote.

const READ = {
  "<u8": (view, at) => view.getBigUint64(at, true), "<i8": (view, at) => view.getBigInt64(at, true),
  "<f8": (view, at) => view.getFloat64(at, true), "<u4": (view, at) => view.getUint32(at, true),
  "<i4": (view, at) => view.getInt32(at, true), "<u2": (view, at) => view.getUint16(at, true),
  "u1": (view, at) => view.getUint8(at),
};
const BYTES = { "<u8": 8, "<i8": 8, "<f8": 8, "<u4": 4, "<i4": 4, "<u2": 2, "u1": 1 };

function takeApart(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  return { head, at: 4 + length };
}

function rowBytes(fields) {
  return fields.reduce((most, field) => Math.max(most, field.offset + BYTES[field.type]), 0);
}

// {name: [values]} of the rows in a buffer; whole numbers of 64 bits as BigInt
function columnsOf(buffer, fields, names) {
  const view = new DataView(buffer), size = rowBytes(fields), count = Math.floor(buffer.byteLength / size);
  const columns = {};
  for (const field of fields.filter((f) => !names || names.includes(f.name))) {
    const read = READ[field.type], column = new Array(count);
    for (let row = 0; row < count; row++) column[row] = read(view, row * size + field.offset);
    columns[field.name] = column;
  }
  return columns;
}

// one part of the CSV for each thousand rows, as a Blob accepts
function csvParts(buffer, fields) {
  const columns = columnsOf(buffer, fields), names = fields.map((f) => f.name);
  const count = columns[names[0]].length, parts = [names.join(",") + "\n"];
  for (let from = 0; from < count; from += 1000) {
    const lines = [];
    for (let row = from; row < Math.min(from + 1000, count); row++) {
      lines.push(names.map((name) => (Number.isNaN(columns[name][row]) ? "nan" : String(columns[name][row]))).join(","));
    }
    parts.push(lines.join("\n") + "\n");
  }
  return parts;
}
