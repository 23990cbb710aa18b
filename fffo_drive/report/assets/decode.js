/* The page's numbers: base64 into arrays, the part of them in view, the nearest to a place. NaN is a gap. */
const Data = (() => {
  "use strict";

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;

  function decode(part) {
    if (part.f4 !== undefined) return new Float32Array(bytes(part.f4));
    const steps = new Int16Array(bytes(part.i2));
    const values = new Float32Array(steps.length);
    for (let i = 0; i < steps.length; i++) values[i] = steps[i] === -32768 ? NaN : steps[i] * part.scale + part.offset;
    return values;
  }

  /* Edges of a histogram have one entry more than its heights. */
  function series(encoded) {
    const s = { ...encoded, y: decode(encoded.y), shown: true };
    const uniform = encoded.x.step !== undefined;
    s.xs = uniform ? null : decode(encoded.x);
    s.x = uniform ? (i) => encoded.x.start + i * encoded.x.step : (i) => s.xs[i];
    s.low = encoded.low ? decode(encoded.low) : null;
    s.high = encoded.high ? decode(encoded.high) : null;
    s.edges = s.draw === "steps" || s.draw === "filled";
    s.sorted = true;
    for (let i = 1; s.xs && i < s.xs.length && s.sorted; i++) s.sorted = s.xs[i] >= s.xs[i - 1];
    return s;
  }

  /* First index whose abscissa is at least x; of a sorted series. */
  function lowerBound(s, x) {
    let low = 0, high = s.xs ? s.xs.length : s.y.length;
    if (!s.xs) return Math.min(high, Math.max(0, Math.ceil((x - s.x(0)) / (s.x(1) - s.x(0)))));
    while (low < high) {
      const middle = (low + high) >> 1;
      if (s.xs[middle] < x) low = middle + 1; else high = middle;
    }
    return low;
  }

  /* Indices [from, to) in view, one more on either side so that lines leave the picture; all of an unsorted series. */
  function inView(s, min, max) {
    if (!s.sorted) return [0, s.y.length];
    return [Math.max(0, lowerBound(s, min) - 1), Math.min(s.y.length, lowerBound(s, max) + 1)];
  }

  function nearest(s, x) {
    const i = lowerBound(s, x);
    if (s.edges) return i - 1;
    return i > 0 && (i >= s.y.length || x - s.x(i - 1) < s.x(i) - x) ? i - 1 : i;
  }

  /* [min, max] of the ordinates in view, intervals included; null when nothing is. */
  function range(all, xMin, xMax, positive) {
    let min = Infinity, max = -Infinity;
    for (const s of all) {
      if (!s.shown) continue;
      const [from, to] = inView(s, xMin, xMax);
      for (let i = from; i < to; i++) {
        const y = s.y[i], low = s.low && s.low[i] < y ? s.low[i] : y, high = s.high && s.high[i] > y ? s.high[i] : y;
        if (positive && !(y > 0)) continue;
        if (low < min) min = low;
        if (high > max) max = high;
      }
    }
    return max >= min ? [min, max] : null;
  }

  return { series, inView, nearest, range };
})();
