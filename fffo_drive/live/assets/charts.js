"use strict";
// The five pictures. Series differ in dash and weight as well as in colour and carry their names and values.

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
  { title: "Ticks, largest of 20 ms", unit: "µs", series: [
    { name: "lateness_ns", label: "lateness", part: 1, factor: 1e-3, colour: "purple", width: 1.2 },
    { name: "busy_ns", label: "work", part: 1, factor: 1e-3, colour: "grey", width: 1.2, dash: [4, 3] }] },
];

function cssColour(name) { return getComputedStyle(document.documentElement).getPropertyValue(name).trim(); }
function shown(value) { return value == null ? "–" : (Math.abs(value) >= 1000 ? value.toFixed(0) : value.toPrecision(3)).replace("-", "−"); }

// three rows of pictures fit a laptop's screen
function sizeIn(place) { return { width: Math.max(240, place.clientWidth || 600), height: Math.round(Math.min(230, Math.max(130, 0.19 * innerHeight))) }; }
function axisOf(size, values) { return { stroke: cssColour("--quiet"), grid: { stroke: cssColour("--grid"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif", size, values: (u, ticks) => ticks.map((t) => values(t).replace("-", "−")) }; }

class Picture {
  constructor(spec, parent, onSelect, onReset) {
    this.spec = spec;
    this.off = new Set();
    this.onSelect = onSelect;
    this.onReset = onReset;
    this.figure = document.createElement("figure");
    const head = document.createElement("figcaption"), title = document.createElement("b");
    title.textContent = `${spec.title}, ${spec.unit}`;
    head.append(title);
    this.values = spec.series.map((series, i) => head.appendChild(this.legend(series, i)).lastElementChild);
    this.plotAt = document.createElement("div");
    this.plotAt.className = "plot";
    this.figure.append(head, this.plotAt);
    parent.insertBefore(this.figure, parent.lastElementChild); // the histogram stays last
    this.build();
  }

  legend(series, i) {
    const button = document.createElement("button");
    button.type = "button";
    button.setAttribute("aria-pressed", "true");
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg"), line = document.createElementNS(svg.namespaceURI, "line");
    svg.setAttribute("width", "30"); svg.setAttribute("height", "8"); svg.setAttribute("aria-hidden", "true");
    for (const [key, value] of Object.entries({ x1: 0, x2: 30, y1: 4, y2: 4, stroke: `var(--series-${series.colour})`, "stroke-width": series.width + 0.4, "stroke-dasharray": (series.dash || []).join(" ") })) line.setAttribute(key, value);
    svg.append(line);
    const value = document.createElement("span");
    value.className = "value";
    button.append(svg, series.label, value);
    button.addEventListener("click", () => {
      const hide = !this.off.has(i);
      if (hide) this.off.add(i); else this.off.delete(i);
      button.setAttribute("aria-pressed", String(!hide));
      this.build();
    });
    return button;
  }

  size() { return sizeIn(this.plotAt); }

  build() {
    const data = this.plot ? this.plot.data : null, scale = this.plot ? this.plot.scales.x : null;
    if (this.plot) this.plot.destroy();
    const series = [{}], bands = [];
    this.spec.series.forEach((s, i) => {
      const stroke = cssColour(`--series-${s.colour}`), show = !this.off.has(i);
      if (s.band) {
        const at = series.length;
        series.push({ stroke: stroke + "55", width: 0.5, points: { show: false }, show }, { stroke: stroke + "55", width: 0.5, points: { show: false }, show });
        bands.push({ series: [at, at + 1], fill: stroke + "33" });
      }
      series.push({ label: s.label, stroke, width: s.width, dash: s.dash, points: { show: false }, show });
    });
    const own = this;
    this.plot = new uPlot({
      ...this.size(), series, bands, legend: { show: false }, pxAlign: 0, padding: [8, 14, 0, 0],
      scales: { x: { time: false } },
      axes: [axisOf(26, (t) => `${+t.toFixed(3)} s`), axisOf(58, (t) => String(+t.toPrecision(6)))],
      cursor: { sync: { key: "scope" }, drag: { x: true, y: false, setScale: false }, bind: { dblclick: () => () => { own.onReset(); return null; } } },
      hooks: { setSelect: [(u) => {
        if (u.select.width > 4) own.onSelect(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
        u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
      }], setCursor: [(u) => own.read(u)] },
    }, data || series.map(() => []), this.plotAt);
    if (data && scale && scale.min != null) this.plot.setScale("x", { min: scale.min, max: scale.max });
  }

  draw(store, from, to, constant, tell) {
    const [begin, end] = store.between(from, to);
    const data = [store.time.slice(begin, end)];
    this.spec.series.forEach((s, i) => {
      const factor = (s.factor || 1) / (s.perKt ? constant || NaN : 1);
      if (s.band) data.push(store.column(s.name, 1, begin, end, factor), store.column(s.name, 0, begin, end, factor));
      const line = store.column(s.name, s.part === undefined ? 2 : s.part, begin, end, factor);
      data.push(line);
      if (tell && !this.crossed) this.values[i].textContent = shown(line[line.length - 1]);
    });
    this.plot.batch(() => {
      this.plot.setData(data, false);
      this.plot.setScale("x", { min: from, max: to });
    });
  }

  resize() { this.plot.setSize(this.size()); }

  remove() {
    this.plot.destroy();
    this.figure.remove();
  }

  // values at the crosshair of any picture; the last ones without
  read(u) {
    const at = u.cursor.idx;
    this.crossed = at != null && u.cursor.left >= 0;
    if (!this.crossed) return;
    let column = 1;
    this.spec.series.forEach((s, i) => {
      if (s.band) column += 2;
      this.values[i].textContent = shown(u.data[column++][at]);
    });
  }
}

// friction over velocity, while it turns: what the current leaves beside the inertia feed-forward, and what the observer makes of it
class FrictionMap {
  constructor(parent) {
    this.figure = document.createElement("figure");
    this.figure.id = "friction-map";
    const head = document.createElement("figcaption"), title = document.createElement("b");
    title.textContent = "Friction over velocity, Nm";
    const key = document.createElement("span");
    key.textContent = "○ motor torque minus the inertia feed-forward   ● estimate";
    head.append(title, key);
    this.plotAt = document.createElement("div");
    this.plotAt.className = "plot";
    this.figure.append(head, this.plotAt);
    parent.insertBefore(this.figure, parent.lastElementChild);
    this.build();
  }

  size() { return sizeIn(this.plotAt); }

  build() {
    const data = this.points || [[], [], []];
    if (this.plot) this.plot.destroy();
    const dots = (colour, filled) => ({ paths: () => null, points: { show: true, size: 4, width: 1, stroke: cssColour(colour), fill: filled ? cssColour(colour) : "transparent" } });
    this.plot = new uPlot({
      ...this.size(), mode: 1, legend: { show: false }, padding: [8, 14, 0, 0],
      scales: { x: { time: false } }, axes: [axisOf(26, (t) => `${+t.toPrecision(4)} rps`), axisOf(58, (t) => String(+t.toPrecision(6)))],
      series: [{ sorted: 0 }, dots("--series-grey", false), dots("--series-green", true)],
      cursor: { points: { show: false } },
    }, data, this.plotAt);
  }

  draw(store, from, to, constant, tell) {
    if (!tell) return; // a cloud of points: five pictures a second
    const [begin, end] = store.between(from, to);
    const speed = store.column("velocity_rps", 2, begin, end, 1);
    const motor = store.column("current_a", 2, begin, end, constant || NaN);
    const inertia = store.column("inertia_nm", 2, begin, end, 1), estimate = store.column("friction_nm", 2, begin, end, 1);
    const order = speed.map((v, i) => i).filter((i) => speed[i] != null).sort((a, b) => speed[a] - speed[b]);
    const left = (i) => (motor[i] == null ? null : motor[i] - (inertia[i] || 0));
    this.points = [order.map((i) => speed[i]), order.map(left), order.map((i) => estimate[i])];
    this.plot.setData(this.points);
  }

  resize() { this.plot.setSize(this.size()); }
}

// how many ticks woke how late, as bars with their shares written beside them
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
