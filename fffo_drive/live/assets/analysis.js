"use strict";
// Charts computed from rows at the full rate: spectrum, step response, phase. Each declares the signals that it
// needs and takes them as a RowStore; settings are a plain object, so that a saved view holds them.

const PEAKS = 5;
const LEAST_REVOLUTIONS = 2; // fewer do not separate neighbouring orders
const SEGMENTS = 4.5; // that many lengths of a segment fit in the window: eight of them, overlapping by half
const LONGEST_LAG_S = 0.25, LAG_SHARE = 0.25; // longest lag searched for, and its largest share of the window
const LEAST_ROWS = 64;
const TOGETHER = 3, SHOWN_BEYOND = 1.5; // coherent neighbours that set the highest frequency shown, and the margin above it

class Analysis extends OwnAxisChart {
  // options: {name: {label, choices: [[value, text]]}}
  constructor(spec, parent, view, options, settings) {
    super(spec, parent, view);
    this.settings = settings;
    this.controls = {};
    const line = element("span", this.head, "", { class: "settings" });
    for (const [name, { label, choices }] of Object.entries(options)) {
      const select = element("select", element("label", line, `${label} `), "", { "data-setting": name });
      select.replaceChildren(...choices.map(([value, text]) => new Option(text, value)));
      select.addEventListener("change", () => { this.settings[name] = select.value; this.changed(); });
      this.controls[name] = select;
    }
    this.settingsLine = line;
    this.readout = element("output", this.head, "", { class: "readout" });
    this.figure.dataset.analysis = spec.key;
    this.set({});
  }

  set(settings) {
    for (const [name, value] of Object.entries(settings)) if (name in this.settings && (!this.controls[name] || [...this.controls[name].options].some((o) => o.value === value))) this.settings[name] = value;
    for (const [name, select] of Object.entries(this.controls)) select.value = this.settings[name];
    this.apply();
  }
  changed() { this.apply(); this.view.changed(); this.view.again(); }
  apply() {}
  say(text) { if (this.readout.textContent !== text) this.readout.textContent = text; }
  empty(text) { this.found = null; this.show([[], ...this.spec.series.map(() => [])]); this.say(text); }
  numbers(rows, names) { return names.map((name) => Dsp.evenly(rows.values("tick"), rows.values(name))); }
}

class Spectrum extends Analysis {
  constructor(parent, view, signals) {
    super({ key: "spectrum", title: "Spectrum", unit: "", x: { unit: "Hz", inverse: "s" }, series: [{ label: "per bin", colour: "blue", width: 1.4 }] }, parent, view, {
      signal: { label: "of", choices: signals.map((s) => [s, s]) },
      over: { label: "over", choices: [["frequency", "frequency"], ["order", "order (per revolution)"]] },
      size: { label: "as", choices: [["amplitude", "amplitude"], ["rms", "rms"]] },
      window: { label: "window", choices: [["hann", "Hann"], ["flattop", "flat top"], ["none", "none"]] },
      scale: { label: "values", choices: [["linear", "linear"], ["log", "logarithmic"]] },
    }, { signal: "error_rps", over: "frequency", size: "amplitude", window: "hann", scale: "linear" });
  }

  get names() { return this.settings.over === "order" ? [this.settings.signal, "position_rev"] : [this.settings.signal]; }

  apply() {
    const { signal, over, size, scale } = this.settings, order = over === "order";
    this.spec.x = { unit: order ? "/rev" : "Hz", inverse: order ? "rev" : "s" };
    this.titled(`Spectrum of ${signal}`, `${this.view.unitOf(signal)} ${size}`);
    this.xRange = null;
    if (this.log !== (scale === "log")) { this.log = scale === "log"; this.yRange = null; this.build(); }
    this.cursors.clear();
  }

  take(rows) {
    const { signal, over, size, window } = this.settings;
    if (!rows || rows.count < LEAST_ROWS) { this.empty("waiting for rows at the full rate"); return; }
    const [[x, filled], position] = this.numbers(rows, this.names);
    let at = rows.rate, values = x, span = `${shown(x.length / rows.rate)} s at ${rows.rate} Hz`;
    if (over === "order") {
      const turned = Dsp.overPosition(x, position[0]);
      if (turned.revolutions < LEAST_REVOLUTIONS) { this.empty(`turns ${shown(turned.revolutions)} revolutions in one direction within the window; orders need ${LEAST_REVOLUTIONS}`); return; }
      [values, at, span] = [turned.x, turned.perRev, `${shown(turned.revolutions)} revolutions in one direction`];
    }
    const found = Dsp.spectrum(values, at, window, size === "rms");
    const unit = this.view.unitOf(signal), inX = this.spec.x.unit, begin = 1; // bin 0 is the mean, which is subtracted
    const abscissa = Array.from(found.at.subarray(begin)), bins = Array.from(found.size.subarray(begin), (v) => (this.log ? v || null : v));
    this.found = { ...found, peaks: Dsp.peaks(abscissa, bins, PEAKS, 2 * found.resolution) };
    const peaks = this.found.peaks.map(([k, x_]) => `${shown(x_, 4)} ${inX} ${shown(bins[k])} ${unit}`);
    this.show([abscissa, bins]);
    this.say(`${peaks.length ? `peaks ([ and ] put the cursor there): ${peaks.join(" · ")}; ` : ""}mean ${shown(found.mean)} ${unit}; ${span}, resolution ${shown(found.resolution)} ${inX}${filled ? `; ${filled} missing ticks filled in` : ""}`);
  }

  drawCursors(u) {
    super.drawCursors(u);
    const { ctx } = u, pixels = devicePixelRatio, { min, max } = u.scales.x;
    if (!this.found || min == null) return;
    ctx.save();
    ctx.fillStyle = cssColour("--text");
    for (const [k] of this.found.peaks) {
      if (u.data[0][k] === undefined || u.data[0][k] < min || u.data[0][k] > max) continue;
      const left = u.valToPos(u.data[0][k], "x", true), top = Math.max(u.bbox.top + 8 * pixels, u.valToPos(u.data[1][k], "y", true) - 3 * pixels);
      ctx.beginPath(); ctx.moveTo(left, top); ctx.lineTo(left - 4 * pixels, top - 7 * pixels); ctx.lineTo(left + 4 * pixels, top - 7 * pixels); ctx.fill();
    }
    ctx.restore();
  }

  key(e) {
    if ((e.key === "[" || e.key === "]") && this.found && this.found.peaks.length) {
      const places = this.found.peaks.map(([k]) => this.data[0][k]).sort((a, b) => a - b), now = this.cursors.at[this.cursors.active];
      const next = e.key === "]" ? places.find((x) => now === null || x > now) : places.findLast((x) => now === null || x < now);
      if (next !== undefined) this.cursors.set(this.cursors.active, next);
      return true;
    }
    return super.key(e);
  }
}

class StepResponse extends Analysis {
  constructor(parent, view, signals) {
    const choices = signals.map((s) => [s, s]);
    super({ key: "step", title: "Step response", unit: "", x: { unit: "ms", inverse: "kHz" }, series: [
      { label: "response", colour: "blue", width: 2 },
      { label: "reference", colour: "ink", width: 1.2, dash: [7, 5] },
      { label: "kept response", colour: "orange", width: 1.6, dash: [3, 3] },
      { label: "kept reference", colour: "grey", width: 1, dash: [1, 3] }] }, parent, view, {
      reference: { label: "of", choices }, response: { label: "to", choices },
      band: { label: "settled within", choices: [["0.02", "2 %"], ["0.05", "5 %"]] },
    }, { reference: "reference_rps", response: "velocity_rps", band: "0.02" });
    for (const [text, does] of [["Trigger on its middle (m)", () => this.view.arm(this.settings.reference)], ["Keep (k)", () => this.keep()], ["Forget kept", () => this.forget()]]) {
      element("button", this.settingsLine, text, { type: "button", class: "small" }).addEventListener("click", does);
    }
  }

  get names() { return []; } // it uses the rows of the trigger, not live ones
  apply() {
    const { response, reference } = this.settings;
    this.titled(`Step response of ${response}`, this.view.unitOf(response));
    if (this.rows) this.compute();
  }
  take() { if (!this.rows) this.empty("waiting for a trigger on the step: level trigger on the reference, or “Trigger on its middle”"); }

  // rows around a trigger, all signals, and its time in seconds
  triggered(rows, time) {
    Object.assign(this, { rows, time });
    this.compute();
  }

  compute() {
    const { rows, time } = this, { reference, response, band } = this.settings;
    const [[ref], [res]] = this.numbers(rows, [reference, response]), first = Number(rows.values("tick")[0]), zero = Math.round(time * rows.rate);
    const at = Array.from(ref, (_, i) => (first + i - zero) / rows.rate);
    this.last = { at, reference: Array.from(ref), response: Array.from(res), band: Number(band), found: Dsp.step(at, Array.from(ref), Array.from(res), 0, Number(band)) };
    this.overlay();
  }

  overlay() {
    const { last, kept } = this, ms = (one) => one.at.map((t) => +(1000 * t).toFixed(4));
    const none = [[], [], []];
    const joined = uPlot.join([last ? [ms(last), last.response, last.reference] : none, kept ? [ms(kept), kept.response, kept.reference] : none]);
    this.show(joined);
    const unit = this.spec.unit;
    const described = ({ found, band }) => found.problem || `rise (10–90 %) ${shown(1000 * found.rise)} ms, overshoot ${shown(found.overshoot)} %, settled (±${100 * band} %) ${found.settling === null ? "not within the window" : `after ${shown(1000 * found.settling)} ms`}, final value ${shown(found.final, 4)} ${unit} of ${shown(found.to, 4)}`;
    this.say([last && described(last), kept && `kept: ${described(kept)}`].filter(Boolean).join("\n"));
  }

  keep() { if (this.last) { this.kept = this.last; this.overlay(); } }
  forget() { this.kept = null; if (this.last) this.overlay(); }

  key(e) {
    if (e.key === "k") this.keep();
    else if (e.key === "m") this.view.arm(this.settings.reference);
    else return super.key(e);
    return true;
  }
}

class Phase extends Analysis {
  constructor(parent, view, signals) {
    const choices = signals.map((s) => [s, s]);
    super({ key: "phase", title: "Phase", unit: "°", x: { unit: "Hz", inverse: "s" }, series: [
      { label: "phase", colour: "blue", width: 2 },
      { label: "coherence (right)", colour: "grey", width: 1.2, dash: [2, 3], scale: "coherence", unit: "of 1" }] }, parent, view, {
      response: { label: "of", choices }, reference: { label: "after", choices },
      as: { label: "as", choices: [["degrees", "degrees"], ["ms", "lag in ms"]] },
    }, { response: "velocity_rps", reference: "reference_rps", as: "degrees" });
  }

  get names() { return [...new Set([this.settings.reference, this.settings.response])]; }
  moreScales() { return { coherence: { range: [0, 1] } }; }
  moreAxes() { return [{ ...axisOf(30, (t) => String(t)), scale: "coherence", side: 1, grid: { show: false } }]; }

  apply() {
    const { response, reference, as } = this.settings;
    this.titled(`Phase of ${response} after ${reference}`, as === "ms" ? "ms of lag" : "°");
  }

  xShown(low, high) { return this.xRange || (this.seen ? [0, this.seen] : super.xShown(low, high)); }

  take(rows) {
    const { reference, response, as } = this.settings;
    if (!rows || rows.count < LEAST_ROWS) { this.empty("waiting for rows at the full rate"); return; }
    const [[x], [y]] = this.numbers(rows, [reference, response]), { rate } = rows;
    if ([x, y].some((signal) => Math.max(...signal) === Math.min(...signal))) { this.empty(`${x.every((v) => v === x[0]) ? reference : response} does not change within the window: no phase`); return; }
    const segment = 2 ** Math.floor(Math.log2(x.length / SEGMENTS)), found = Dsp.crossSpectrum(x, y, rate, segment);
    const most = Math.max(1, Math.round(Math.min(LONGEST_LAG_S * rate, LAG_SHARE * x.length))), lag = Dsp.lag(x, y, most);
    const lagMs = (k) => -found.phase[k] / 360 / found.at[k] * 1000;
    const at = Array.from(found.at.subarray(1)), clear = at.map((_, i) => found.coherence[i + 1] >= found.needed);
    const last = clear.findLastIndex((_, i) => i >= TOGETHER && clear.slice(i - TOGETHER, i + 1).every(Boolean)); // a single one may be chance
    this.seen = last < 0 ? null : Math.min(rate / 2, SHOWN_BEYOND * at[last]);
    this.found = { ...found, lag };
    this.show([at, at.map((_, i) => (clear[i] ? (as === "ms" ? lagMs(i + 1) : found.phase[i + 1]) : null)), Array.from(found.coherence.subarray(1))]);
    let k = 1;
    for (let i = 2; i < found.cross.length; i++) if (found.cross[i] > found.cross[k]) k = i;
    const over = lag.clear ? `lag ${shown(1000 * lag.samples / rate)} ms (correlation ${shown(lag.correlation, 2)})` : `lag not determined: correlation ${shown(lag.correlation, 2)}`;
    const there = found.coherence[k] >= found.needed ? `${shown(found.phase[k])}°, ${shown(lagMs(k))} ms` : "phase not determined";
    this.say(`${over}; strongest together at ${shown(found.at[k])} Hz: ${there}, coherence ${shown(found.coherence[k], 2)}; below ${shown(found.needed, 2)} (${found.segments} segments) no phase is drawn`);
  }
}
