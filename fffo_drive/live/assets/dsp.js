"use strict";
// Spectra, resampling over position, lag and coherence, figures of a step response: numbers in, numbers out, no page.
// tests/live/test_dsp.py compares each function with NumPy and SciPy.

const Dsp = (() => {
  const CORRELATION_NEEDED = 0.6; // below it, the largest correlation may be chance or another signal
  const COHERENCE_CHANCE = 0.001; // probability that two unrelated signals appear coherent at a frequency
  const RISE_FROM = 0.1, RISE_TO = 0.9;
  const STEP_REST = 0.1; // share of the step that the reference may move before it and at the end
  const STEP_END = 0.15; // of the time after the step: what counts as the final value

  const mean = (x) => { let sum = 0; for (const v of x) sum += v; return sum / Math.max(1, x.length); };
  const powerOfTwo = (least) => { let n = 1; while (n < least) n *= 2; return n; };

  // in place; the length is a power of two
  function fft(re, im) {
    const n = re.length;
    for (let i = 1, j = 0; i < n; i++) {
      let bit = n >> 1;
      for (; j & bit; bit >>= 1) j ^= bit;
      j |= bit;
      if (i < j) { [re[i], re[j]] = [re[j], re[i]]; [im[i], im[j]] = [im[j], im[i]]; }
    }
    const cos = new Float64Array(n / 2), sin = new Float64Array(n / 2);
    for (let i = 0; i < n / 2; i++) { cos[i] = Math.cos(2 * Math.PI * i / n); sin[i] = -Math.sin(2 * Math.PI * i / n); }
    for (let size = 2; size <= n; size *= 2) {
      const half = size / 2, stride = n / size;
      for (let begin = 0; begin < n; begin += size) {
        for (let k = 0; k < half; k++) {
          const a = begin + k, b = a + half, c = cos[k * stride], s = sin[k * stride];
          const r = re[b] * c - im[b] * s, i = re[b] * s + im[b] * c;
          re[b] = re[a] - r; im[b] = im[a] - i; re[a] += r; im[a] += i;
        }
      }
    }
  }

  // periodic, as spectra want it
  function weights(kind, n) {
    const terms = { hann: [0.5, 0.5], flattop: [0.21557895, 0.41663158, 0.277263158, 0.083578947, 0.006947368], none: [1] }[kind];
    return Float64Array.from({ length: n }, (_, i) => terms.reduce((sum, a, k) => sum + (k % 2 ? -a : a) * Math.cos(2 * Math.PI * k * i / n), 0));
  }

  // Values at ticks that may have gaps, as [values at every tick, number of ticks filled in]; NaN is filled in, too
  function evenly(ticks, values) {
    const first = Number(ticks[0]), count = Number(ticks[ticks.length - 1]) - first + 1, out = new Float64Array(count);
    let filled = 0, before = -1;
    for (let i = 0; i < ticks.length; i++) {
      const value = Number(values[i]);
      if (!Number.isFinite(value)) continue;
      const at = Number(ticks[i]) - first;
      for (let k = before + 1; k < at; k++) { out[k] = before < 0 ? value : out[before] + (value - out[before]) * (k - before) / (at - before); filled++; }
      out[at] = value;
      before = at;
    }
    for (let k = before + 1; k < count; k++) { out[k] = before < 0 ? 0 : out[before]; filled++; }
    return [out, filled];
  }

  // One-sided spectrum of x without its mean: a sine gives its amplitude (or rms) at its frequency. `rate`: samples
  // per unit of the abscissa. Padded to a power of two; `resolution`: smallest distance of two lines.
  function spectrum(x, rate, kind, rms) {
    const count = x.length, n = powerOfTwo(count), w = weights(kind, count), level = mean(x);
    const re = new Float64Array(n), im = new Float64Array(n);
    let sum = 0, squares = 0;
    for (let i = 0; i < count; i++) { re[i] = (x[i] - level) * w[i]; sum += w[i]; squares += w[i] * w[i]; }
    fft(re, im);
    const bins = n / 2 + 1, at = new Float64Array(bins), size = new Float64Array(bins);
    for (let k = 0; k < bins; k++) {
      const onesided = k === 0 || k === n / 2 ? 1 : 2;
      at[k] = k * rate / n;
      size[k] = onesided * Math.hypot(re[k], im[k]) / sum * (rms && onesided === 2 ? Math.SQRT1_2 : 1);
    }
    return { at, size, mean: level, resolution: rate * squares / (sum * sum) };
  }

  // The largest maxima, [place in `size`, abscissa between the bins], largest first, none nearer than `apart` to a larger
  function peaks(at, size, most, apart) {
    const found = [];
    for (let k = 1; k < size.length - 1; k++) if (size[k] > size[k - 1] && size[k] >= size[k + 1]) found.push(k);
    found.sort((a, b) => size[b] - size[a]);
    const kept = [];
    for (const k of found) {
      if (kept.length === most) break;
      if (kept.some(([other]) => Math.abs(at[k] - at[other]) < apart)) continue;
      const bend = size[k - 1] - 2 * size[k] + size[k + 1];
      kept.push([k, at[k] + (bend ? 0.5 * (size[k - 1] - size[k + 1]) / bend : 0) * (at[1] - at[0])]);
    }
    return kept;
  }

  // x at equal steps of position, over the longest way in one direction: {x, perRev, revolutions}. Where the position
  // steps back (its noise, at low speed) samples are left out.
  function overPosition(x, position) {
    const reversals = [0], hysteresis = 0.02; // revolutions; less is sensor noise, not a reversal
    let extreme = 0, direction = 0;
    for (let i = 1; i < x.length; i++) {
      const way = position[i] - position[extreme];
      if (direction === 0 ? Math.abs(way) > hysteresis : way * direction < -hysteresis) { if (direction) reversals.push(extreme); direction = Math.sign(way); extreme = i; }
      else if (way * direction > 0) extreme = i;
    }
    reversals.push(x.length - 1);
    let begin = 0, end = 0;
    for (let i = 1; i < reversals.length; i++) if (Math.abs(position[reversals[i]] - position[reversals[i - 1]]) > Math.abs(position[end] - position[begin])) { begin = reversals[i - 1]; end = reversals[i]; }
    const revolutions = Math.abs(position[end] - position[begin]);
    const sign = Math.sign(position[end] - position[begin]), places = [], values = [];
    for (let i = begin; i <= end; i++) {
      const place = sign * (position[i] - position[begin]);
      if (!places.length || place > places[places.length - 1]) { places.push(place); values.push(x[i]); }
    }
    const count = places.length, out = new Float64Array(count);
    for (let i = 0, k = 0; i < count; i++) {
      const place = revolutions * i / count;
      while (k < count - 2 && places[k + 1] < place) k++;
      out[i] = count < 2 ? values[0] : values[k] + (values[k + 1] - values[k]) * (place - places[k]) / (places[k + 1] - places[k]);
    }
    return { x: out, perRev: count / revolutions, revolutions };
  }

  // Welch: Hann segments that overlap by half, each without its mean. Phase of y after x in degrees (a lag is negative),
  // coherence, and `needed`: unrelated signals exceed this coherence with probability COHERENCE_CHANCE.
  function crossSpectrum(x, y, rate, segment) {
    const w = weights("hann", segment), step = segment / 2, bins = segment / 2 + 1;
    const xx = new Float64Array(bins), yy = new Float64Array(bins), real = new Float64Array(bins), imaginary = new Float64Array(bins);
    let segments = 0;
    for (let begin = 0; begin + segment <= x.length; begin += step, segments++) {
      const re = [0, 1].map(() => new Float64Array(segment)), im = [0, 1].map(() => new Float64Array(segment));
      [x, y].forEach((signal, s) => {
        const part = signal.subarray(begin, begin + segment), level = mean(part);
        for (let i = 0; i < segment; i++) re[s][i] = (part[i] - level) * w[i];
        fft(re[s], im[s]);
      });
      for (let k = 0; k < bins; k++) {
        xx[k] += re[0][k] ** 2 + im[0][k] ** 2;
        yy[k] += re[1][k] ** 2 + im[1][k] ** 2;
        real[k] += re[0][k] * re[1][k] + im[0][k] * im[1][k];
        imaginary[k] += re[0][k] * im[1][k] - im[0][k] * re[1][k];
      }
    }
    const at = Float64Array.from(xx, (_, k) => k * rate / segment);
    const phase = Float64Array.from(xx, (_, k) => Math.atan2(imaginary[k], real[k]) * 180 / Math.PI);
    const coherence = Float64Array.from(xx, (_, k) => (real[k] ** 2 + imaginary[k] ** 2) / (xx[k] * yy[k] || Infinity));
    const cross = Float64Array.from(xx, (_, k) => Math.hypot(real[k], imaginary[k]));
    // the powers of two Hann segments that overlap by half are correlated by (1/6)^2
    const independent = segments > 1 ? segments / (1 + 2 * (segments - 1) / segments / 36) : 1;
    const needed = independent > 1 ? 1 - COHERENCE_CHANCE ** (1 / (independent - 1)) : 1;
    return { at, phase, coherence, cross, segments, needed };
  }

  // Lag of y behind x in samples: the largest correlation within `most` samples, interpolated by a
  // parabola; each shift uses the overlapping part. `clear`: large enough, and not at the end of the search range.
  function lag(x, y, most) {
    const count = x.length, n = powerOfTwo(2 * count), meanX = mean(x), meanY = mean(y);
    const re = new Float64Array(n), im = new Float64Array(n), xs = new Float64Array(count + 1), ys = new Float64Array(count + 1);
    for (let i = 0; i < count; i++) {
      re[i] = x[i] - meanX; im[i] = y[i] - meanY; // one transform for both
      xs[i + 1] = xs[i] + re[i] ** 2; ys[i + 1] = ys[i] + im[i] ** 2;
    }
    fft(re, im);
    const cr = new Float64Array(n), ci = new Float64Array(n);
    for (let k = 0; k < n; k++) {
      const m = (n - k) % n;
      const xr = (re[k] + re[m]) / 2, xi = (im[k] - im[m]) / 2, yr = (im[k] + im[m]) / 2, yi = (re[m] - re[k]) / 2;
      cr[k] = xr * yr + xi * yi; ci[k] = -(xr * yi - xi * yr); // its conjugate: the transform back is one forward
    }
    fft(cr, ci);
    const correlation = (d) => {
      const energy = d >= 0 ? (xs[count - d]) * (ys[count] - ys[d]) : (xs[count] - xs[-d]) * ys[count + d];
      return energy > 0 ? cr[(d + n) % n] / n / Math.sqrt(energy) : 0;
    };
    let best = 0;
    for (let d = -most; d <= most; d++) if (correlation(d) > correlation(best)) best = d;
    const [a, b, c] = [correlation(best - 1), correlation(best), correlation(best + 1)], bend = a - 2 * b + c;
    const samples = best + (bend < 0 ? 0.5 * (a - c) / bend : 0);
    return { samples, correlation: b, clear: b >= CORRELATION_NEEDED && Math.abs(best) < most };
  }

  // Figures of a step at `t0` (s): {rise, overshoot, settling, final, ...}, or {problem} in words. Rise: 10 to 90 % of
  // the response's total change; overshoot in per cent of it; settling: from t0 until it stays within `band` of its final value.
  function step(time, reference, response, t0, band) {
    let at = 0;
    while (at < time.length && time[at] < t0) at++;
    const after = time.length - at, tail = time.length - Math.max(2, Math.round(STEP_END * after));
    if (at < 4 || after < 20) return { problem: "too few rows before or after the step" };
    const before = reference.slice(0, at - 1), end = reference.slice(tail);
    const from = mean(before), to = mean(end), height = to - from;
    const largest = Math.max(...reference.map(Math.abs));
    const moves = (part, level) => part.some((v) => Math.abs(v - level) > STEP_REST * Math.abs(height));
    if (Math.abs(height) < 1e-6 + 0.02 * largest) return { problem: "the reference has no step here" };
    if (moves(before, from)) return { problem: "the reference moves before the step: less pre-trigger, or a window that holds one step" };
    if (moves(end, to)) return { problem: "the reference moves at the end: a window that ends before the next step" };
    const start = mean(response.slice(0, at - 1)), final = mean(response.slice(tail)), way = final - start;
    if (Math.abs(way) < 0.2 * Math.abs(height)) return { problem: "the response does not follow the step" };
    const share = response.map((v) => (v - start) / way);
    const crossing = (level) => {
      for (let i = Math.max(1, at); i < share.length; i++) if (share[i] >= level) return share[i - 1] >= level ? time[i] : time[i - 1] + (time[i] - time[i - 1]) * (level - share[i - 1]) / (share[i] - share[i - 1]);
      return NaN;
    };
    let last = time.length - 1;
    while (last >= at && Math.abs(share[last] - 1) <= band) last--;
    const most = share.slice(at).reduce((a, b) => Math.max(a, b), 0);
    return {
      from, to, start, final, height, t0,
      rise: crossing(RISE_TO) - crossing(RISE_FROM),
      overshoot: Math.max(0, 100 * (most - 1)),
      settling: last >= tail ? null : Math.max(0, time[Math.min(last + 1, time.length - 1)] - t0), // null: not within the window
    };
  }

  return { fft, weights, evenly, spectrum, peaks, overPosition, crossSpectrum, lag, step };
})();
