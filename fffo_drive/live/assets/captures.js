"use strict";
// Rows at the full rate, asked for one after the other: all signals, or some of them.

class Captures {
  constructor(wire) {
    this.wire = wire;
    this.number = 0;
    this.waiting = []; // the first one is being answered
  }

  // the fields of rows that hold only these signals, in this order
  static fieldsOf(fields, names) {
    let offset = 0;
    return names.map((name) => {
      const field = { ...fields.find((f) => f.name === name), offset };
      offset += BYTES[field.type];
      return field;
    });
  }

  // resolves with the rows as an ArrayBuffer, empty when there are none (any more) or the connection broke
  take(seconds, untilTick, signals = []) {
    return new Promise((done) => {
      this.waiting.push({ id: ++this.number, seconds, untilTick, signals, parts: [], rows: 0, done });
      if (this.waiting.length === 1) this.ask();
    });
  }

  get busy() { return this.waiting.length > 0; }

  ask() {
    const { id, seconds, untilTick, signals } = this.waiting[0];
    if (!this.wire.capture(id, seconds, untilTick, signals)) this.broken();
  }

  heard(head, payload) {
    const first = this.waiting[0];
    if (!first || head.id !== first.id) return;
    first.parts.push(payload);
    first.rows += head.rows;
    if (first.rows < head.total) return;
    this.waiting.shift();
    new Blob(first.parts).arrayBuffer().then(first.done);
    if (this.waiting.length) this.ask();
  }

  broken() { for (const one of this.waiting.splice(0)) one.done(new ArrayBuffer(0)); }
}
