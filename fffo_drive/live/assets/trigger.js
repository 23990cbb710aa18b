"use strict";
// When to hold the charts: a reversal of the reference, a fault, or a signal that crosses a level. Looked for in the
// bins, so that nothing between two redraws is missed; the full-rate rows then give the exact time.

const TRIGGER_SIGNALS = { reversal: "reference_rps", fault: "trip" };
const AUTO_S = 1; // after this time and the window without an event, `auto` shows live rows

class Trigger {
  constructor() {
    this.set({ kind: "none", signal: "reference_rps", level: 0, edge: "rising", mode: "single", pre: 50 });
  }

  set(settings) {
    this.settings = { ...this.settings, ...settings };
    this.begin();
  }

  // another loop or other settings: forget earlier bins
  begin() { this.last = null; this.sign = 0; this.pending = null; }

  get on() { return this.settings.kind !== "none"; }

  // of one bin, Float64Array of (signals, 3): whether the event is in it
  sees(bin, index) {
    const { kind, signal, level, edge } = this.settings;
    if (kind === "none") return false;
    const at = index[TRIGGER_SIGNALS[kind] || signal] * 3, [low, high, last] = bin.subarray(at, at + 3), before = this.last;
    this.last = last;
    if (kind === "fault") return before === 0 && high > 0;
    if (kind === "reversal") { // a rest between two directions does not count
      const sign = Math.abs(last) > 1e-6 ? Math.sign(last) : this.sign, turned = this.sign !== 0 && sign !== this.sign;
      this.sign = sign;
      return turned;
    }
    const rising = (before !== null && before < level && high >= level) || (low < level && last >= level);
    const falling = (before !== null && before >= level && low < level) || (high >= level && last < level);
    return (edge !== "falling" && rising) || (edge !== "rising" && falling);
  }

  // the exact time in full-rate rows: the crossing nearest to the one in the bins
  exact(time, values, near) {
    const { kind, level, edge } = this.settings, at = kind === "level" ? level : 0;
    let best = null;
    for (let i = 1; i < time.length; i++) {
      const above = kind === "fault" ? values[i] > 0 : values[i] >= at, was = kind === "fault" ? values[i - 1] > 0 : values[i - 1] >= at;
      if (above === was || (kind !== "reversal" && edge !== "either" && kind === "level" && above !== (edge === "rising"))) continue;
      if (best === null || Math.abs(time[i] - near) < Math.abs(best - near)) best = time[i];
    }
    return best === null ? near : best;
  }

  get name() {
    const { kind, signal, level, edge } = this.settings;
    return kind === "level" ? `${signal} ${edge === "either" ? "crossing" : edge + " through"} ${level}` : kind;
  }
}
