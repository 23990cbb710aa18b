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

// full-rate rows with the interface of bins of one row; a signal is decoded on first use
class RowStore {
  constructor(buffer, fields, rate) {
    Object.assign(this, { buffer, fields, rate, decoded: {}, scaled: {} });
    this.count = Math.floor(buffer.byteLength / rowBytes(fields));
    this.time = this.values("tick").map((tick) => Number(tick) / rate);
  }

  values(name) { return (this.decoded[name] ||= columnsOf(this.buffer, this.fields, [name])[name]); }
  get now() { return this.count ? this.time[this.count - 1] : 0; }

  // the rows of a time range
  cut(from, to) {
    const size = rowBytes(this.fields);
    return new RowStore(this.buffer.slice(this.place(from) * size, this.place(to) * size), this.fields, this.rate);
  }

  column(name, part, begin, end, factor) {
    const key = `${name} ${factor}`;
    const all = (this.scaled[key] ||= this.values(name).map((v) => (Number.isFinite(Number(v)) ? Number(v) * factor : null)).map((v) => (Number.isNaN(v) ? null : v)));
    return all.slice(begin, end);
  }
}
RowStore.prototype.place = Store.prototype.place;
RowStore.prototype.between = Store.prototype.between;
