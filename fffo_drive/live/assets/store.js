"use strict";
// The last two minutes of bins: for each signal minimum, maximum and last value, and the time of each bin.

const KEPT_BINS = 6000;

class Store {
  constructor(fields) {
    this.names = fields.map((f) => f.name);
    this.index = Object.fromEntries(this.names.map((name, i) => [name, i]));
    this.clear();
  }

  clear() {
    this.time = [];
    this.bins = []; // one Float64Array (signals * 3) for each bin; null for a gap
  }

  // values: Float64Array of (bins, signals, 3)
  add(values, count, rate, binTicks) {
    const width = this.names.length * 3, tick = this.index.tick * 3 + 2;
    for (let i = 0; i < count; i++) {
      const bin = values.slice(i * width, (i + 1) * width), time = bin[tick] / rate;
      const last = this.time[this.time.length - 1];
      if (last !== undefined && time <= last) this.clear();
      else if (last !== undefined && time - last > 1.6 * binTicks / rate) { this.time.push((last + time) / 2); this.bins.push(null); }
      this.time.push(time);
      this.bins.push(bin);
    }
    if (this.time.length > KEPT_BINS + 500) { this.time.splice(0, 500); this.bins.splice(0, 500); }
  }

  get now() { return this.time.length ? this.time[this.time.length - 1] : 0; }

  snapshot() {
    const copy = Object.create(Store.prototype);
    return Object.assign(copy, { names: this.names, index: this.index, time: this.time.slice(), bins: this.bins.slice() });
  }

  // first place at or after a time, and one more to the left so that lines reach the edge
  place(time) {
    let low = 0, high = this.time.length;
    while (low < high) { const middle = (low + high) >> 1; if (this.time[middle] < time) low = middle + 1; else high = middle; }
    return low;
  }

  between(from, to) { return [Math.max(0, this.place(from) - 1), Math.min(this.time.length, this.place(to) + 1)]; }

  // part: 0 minimum, 1 maximum, 2 last
  column(name, part, begin, end, factor) {
    const at = this.index[name] * 3 + part, out = new Array(end - begin);
    for (let i = begin; i < end; i++) {
      const bin = this.bins[i], value = bin ? bin[at] * factor : NaN;
      out[i - begin] = Number.isFinite(value) ? value : null;
    }
    return out;
  }
}

// a capture at the full rate, as a store whose bins are single rows
function storeOfRows(buffer, fields, rate) {
  const columns = columnsOf(buffer, fields), store = new Store(fields), count = columns.tick.length;
  for (let row = 0; row < count; row++) {
    const bin = new Float64Array(fields.length * 3);
    fields.forEach((field, i) => bin.fill(Number(columns[field.name][row]), i * 3, i * 3 + 3));
    store.time.push(Number(columns.tick[row]) / rate);
    store.bins.push(bin);
  }
  return store;
}
