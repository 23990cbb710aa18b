"use strict";
// The charts over time, friction over velocity, and the lateness bars.

const PICTURES = [
  { title: "Velocity", unit: "rps", series: [
    { name: "velocity_rps", label: "velocity", colour: "blue", width: 2.2, band: true },
    { name: "reference_rps", label: "reference", colour: "ink", dash: [7, 5], width: 1.2 }] },
  { title: "Error", unit: "rps", series: [
    { name: "error_rps", label: "reference minus velocity", colour: "orange", width: 1.6, band: true }] },
  { title: "Current and its terms", unit: "A", series: [
    { name: "current_command_a", label: "command", colour: "ink", width: 2 },
    { name: "current_a", label: "measured", colour: "grey", width: 1, dash: [2, 2] },
    { name: "proportional_a", label: "proportional", colour: "orange", width: 1.4, dash: [9, 4] },
    { name: "integral_a", label: "integral", colour: "purple", width: 1.4, dash: [9, 3, 2, 3] },
    { name: "friction_nm", label: "friction", colour: "green", width: 1.8, dash: [3, 3], perKt: true },
    { name: "inertia_nm", label: "inertia", colour: "blue", width: 1.4, dash: [14, 4], perKt: true },
    { name: "effects_nm", label: "effects", colour: "grey", width: 1.4, dash: [1, 4], perKt: true },
    { name: "adapted_nm", label: "adapted", colour: "orange", width: 1.4, dash: [1, 2], perKt: true }] },
  { title: "Friction estimate", unit: "Nm", series: [
    { name: "friction_nm", label: "estimate", colour: "green", width: 1.8 }] },
  { title: "Position", unit: "rev", series: [
    { name: "position_rev", label: "position", colour: "blue", width: 1.8, band: true }] },
  { title: "Ticks, largest of 20 ms", unit: "µs", series: [
    { name: "lateness_ns", label: "lateness", part: 1, factor: 1e-3, colour: "purple", width: 1.2 },
    { name: "busy_ns", label: "work", part: 1, factor: 1e-3, colour: "grey", width: 1.2, dash: [4, 3] }] },
];

// pixels, of a line that moves: without graphics hardware a canvas draws wider lines much more slowly
const MOVING_WIDTH = 1;

class Picture extends Chart {
  constructor(spec, parent, view) { super({ ...spec, x: { unit: "s", inverse: "Hz" } }, parent, view); }

  series() {
    const series = [{}], bands = [];
    this.places = this.spec.series.map((s, i) => {
      const stroke = cssColour(`--series-${s.colour}`), show = !this.off.has(i), at = series.length;
      if (s.band) {
        series.push({ stroke: stroke + "55", width: 0.5, points: { show: false }, show }, { stroke: stroke + "55", width: 0.5, points: { show: false }, show });
        bands.push({ series: [at, at + 1], fill: stroke + "33" });
      }
      series.push({ label: s.label, stroke, width: s.width, dash: s.dash, points: { show: false }, show });
      return series.length - 1;
    });
    return { series, bands };
  }
  columnOf(i) { return this.places[i]; }

  // `moving`: the picture is redrawn many times a second
  draw(store, from, to, constant, tell, moving) {
    this.spec.series.forEach((s, i) => { this.plot.series[this.places[i]].width = moving ? MOVING_WIDTH : s.width; });
    const [begin, end] = store.between(from, to);
    const data = [store.time.slice(begin, end)];
    this.spec.series.forEach((s, i) => {
      const factor = (s.factor || 1) / (s.perKt ? constant || NaN : 1);
      if (s.band) data.push(store.column(s.name, 1, begin, end, factor), store.column(s.name, 0, begin, end, factor));
      const line = store.column(s.name, s.part === undefined ? 2 : s.part, begin, end, factor);
      data.push(line);
      if (tell && !this.crossed) this.values[i].textContent = shown(line[line.length - 1]);
    });
    this.data = data;
    this.plot.batch(() => {
      this.plot.setData(data, false);
      this.plot.setScale("x", { min: from, max: to });
    });
    if (tell) this.tellCursors();
  }
}

// any signal of the row, by its name
function pictureOf(field, parent, view) {
  const series = [{ name: field.name, label: field.name, colour: "purple", width: 1.8, band: true }];
  return new Picture({ title: field.name, unit: field.unit || "-", series }, parent, view);
}

const MOST_POINTS = 600; // of the map, the bins of 12 s: each is a circle to draw
const NEAR_SHARE = 0.01; // of the velocities shown: a cursor on the map gives the median of the points this near

// friction over velocity in motion: motor torque less the inertia feed-forward, and the observer's estimate
class FrictionMap extends OwnAxisChart {
  constructor(parent, view) {
    super({ title: "Friction over velocity", unit: "Nm", x: { unit: "rps" }, series: [
      { label: "motor torque less inertia", colour: "grey", width: 1, mark: "transparent" },
      { label: "estimate", colour: "green", width: 1, mark: "var(--series-green)" }] }, parent, view);
    this.figure.id = "friction-map";
  }

  series() {
    const dots = (s, i) => ({ paths: () => null, show: !this.off.has(i), points: { show: true, size: 4, width: 1, stroke: cssColour(`--series-${s.colour}`), fill: s.mark === "transparent" ? s.mark : cssColour(`--series-${s.colour}`) } });
    return { series: [{ sorted: 0 }, ...this.spec.series.map(dots)], bands: [] };
  }
  points() { return { show: false }; }

  // a circle for each point costs more than all lines: it is redrawn only as often as the numbers
  draw(store, from, to, constant, tell) {
    if (!tell) return;
    const [begin, end] = store.between(from, to);
    const speed = store.column("velocity_rps", 2, begin, end, 1);
    const motor = store.column("current_a", 2, begin, end, constant || NaN);
    const inertia = store.column("inertia_nm", 2, begin, end, 1), estimate = store.column("friction_nm", 2, begin, end, 1);
    const stride = Math.ceil(speed.length / MOST_POINTS);
    const order = [...speed.keys()].filter((i) => i % stride === 0 && speed[i] != null).sort((a, b) => speed[a] - speed[b]);
    const left = (i) => (motor[i] == null ? null : motor[i] - (inertia[i] || 0));
    this.data = [order.map((i) => speed[i]), order.map(left), order.map((i) => estimate[i])];
    this.plot.setData(this.data);
    this.tellCursors();
  }

  valueAt(i, x) {
    const [at, ...columns] = this.plot.data, near = NEAR_SHARE * (this.plot.scales.x.max - this.plot.scales.x.min);
    const found = columns[i].filter((v, k) => v != null && Math.abs(at[k] - x) <= near).sort((a, b) => a - b);
    return found.length ? found[found.length >> 1] : null;
  }
}

// lateness of the ticks as bars, with their shares in numbers
class Histogram {
  constructor(table, edges) {
    this.counts = new Array(edges.length + 1).fill(0);
    this.rows = this.counts.map((_, i) => {
      const row = table.insertRow(), name = document.createElement("th");
      name.scope = "row";
      name.textContent = i < edges.length ? `≤ ${edges[i]} µs` : `> ${edges[i - 1]} µs`;
      const bar = document.createElement("span");
      bar.className = "bar";
      row.append(name);
      const share = row.insertCell();
      row.insertCell().append(bar);
      return { row, share, bar };
    });
  }

  add(counts) { counts.forEach((n, i) => { this.counts[i] += n; }); }

  clear() { this.counts.fill(0); }

  draw() {
    const all = this.counts.reduce((a, b) => a + b, 0), most = Math.max(1, ...this.counts);
    const first = this.counts.findIndex((n) => n), last = this.counts.length - 1 - [...this.counts].reverse().findIndex((n) => n);
    this.rows.forEach(({ row, share, bar }, i) => {
      const n = this.counts[i];
      row.hidden = !all || i < first || i > last;
      const percent = 100 * n / all;
      share.textContent = n === 0 ? "0" : percent < 0.01 ? `${n}` : `${percent.toFixed(2)} %`;
      // the root keeps rare late ticks visible
      bar.style.width = `${n ? Math.max(2, 100 * Math.sqrt(n / most)) : 0}%`;
    });
  }
}
