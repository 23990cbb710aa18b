"use strict";
// One chart: its title line, a plot, two cursors, and the zoom of its values. Subclasses draw the content.
// Series differ in dash and weight as well as in colour and carry their names and values.

const WHEEL_ZOOM = 1.25, PAN_SHARE = 0.1; // shares of the range on display
const CURSOR_STEPS = 400; // Shift and an arrow move by this fraction of the range on display, or to the next point if that is farther

function cssColour(name) { return getComputedStyle(document.documentElement).getPropertyValue(name).trim(); }
function signed(text) { return text.replace("-", "−"); }
function shown(value, digits = 3) { return value == null || !Number.isFinite(value) ? "–" : signed(Math.abs(value) >= 1000 ? value.toFixed(0) : value.toPrecision(digits)); }

// three rows of pictures fit a laptop's screen
function sizeIn(place) { return { width: Math.max(240, place.clientWidth || 600), height: Math.round(Math.min(230, Math.max(120, 0.165 * innerHeight))) }; }
function axisOf(size, values) { return { stroke: cssColour("--quiet"), grid: { stroke: cssColour("--grid"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif", size, values: (u, ticks) => ticks.map((t) => (t == null ? "" : signed(values(t)))) }; }
function element(tag, parent, text, attributes = {}) {
  const made = document.createElement(tag);
  if (text) made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return parent.appendChild(made);
}

// two cursor positions on an abscissa, shared by one or several charts
class Cursors {
  constructor() { this.at = { a: null, b: null }; this.active = "a"; this.charts = new Set(); }

  set(name, x) { this.at[name] = x; this.active = name; this.charts.forEach((chart) => chart.redraw()); }

  // a click sets the first, the second, then the nearer one
  click(x) {
    const { a, b } = this.at;
    this.set(a === null ? "a" : b === null ? "b" : Math.abs(a - x) <= Math.abs(b - x) ? "a" : "b", x);
  }

  clear() { this.at = { a: null, b: null }; this.active = "a"; this.charts.forEach((chart) => chart.redraw()); }
}

class Chart {
  // spec: {title, unit, series, x: {unit, inverse}}, `inverse` being the unit of 1/x; view: {cursors, sync, select(from, to),
  // reset(), pan(share), zoom(factor), changed()}
  constructor(spec, parent, view) {
    Object.assign(this, { spec, view, off: new Set(), yRange: null, data: null, cursors: view.cursors || new Cursors() });
    this.cursors.charts.add(this);
    this.figure = document.createElement("figure");
    this.head = element("figcaption", this.figure);
    element("b", this.head, `${spec.title}, ${spec.unit}`);
    this.values = spec.series.map((series, i) => this.legend(series, i).lastElementChild);
    this.auto = element("button", this.head, "values: automatic (y)", { type: "button", hidden: "" });
    this.auto.addEventListener("click", () => this.setY(null));
    this.cursorLine = element("output", this.head, "", { class: "cursors", hidden: "" });
    this.plotAt = element("div", this.figure, "", { class: "plot", tabindex: "0", role: "group", "aria-label": `${spec.title}: a and b set the cursors, Shift and arrows move them, arrows up and down and Page keys the values` });
    parent.insertBefore(this.figure, parent.querySelector("#lateness"));
    this.plotAt.addEventListener("pointerenter", () => { Chart.current = this; });
    this.plotAt.addEventListener("focus", () => { Chart.current = this; });
    this.plotAt.addEventListener("wheel", (e) => this.wheel(e), { passive: false });
    this.plotAt.addEventListener("mousedown", (e) => this.grab(e), { capture: true });
    this.build();
  }

  legend(series, i) {
    const button = element("button", this.head, "", { type: "button", "aria-pressed": "true" });
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg"), line = document.createElementNS(svg.namespaceURI, "line");
    svg.setAttribute("width", "30"); svg.setAttribute("height", "8"); svg.setAttribute("aria-hidden", "true");
    for (const [key, value] of Object.entries({ x1: 0, x2: 30, y1: 4, y2: 4, stroke: `var(--series-${series.colour})`, "stroke-width": series.width + 0.4, "stroke-dasharray": (series.dash || []).join(" ") })) line.setAttribute(key, value);
    if (series.mark) { // points, not a line
      const dot = document.createElementNS(svg.namespaceURI, "circle");
      for (const [key, value] of Object.entries({ cx: 15, cy: 4, r: 3, stroke: `var(--series-${series.colour})`, fill: series.mark })) dot.setAttribute(key, value);
      svg.append(dot);
    } else svg.append(line);
    button.append(svg, series.label);
    element("span", button, "", { class: "value" });
    button.addEventListener("click", () => { this.hide(i, !this.off.has(i)); this.view.changed(); });
    this.buttons = [...(this.buttons || []), button];
    return button;
  }

  hide(i, hidden) {
    if (hidden) this.off.add(i); else this.off.delete(i);
    this.buttons[i].setAttribute("aria-pressed", String(!hidden));
    this.build();
  }

  titled(title, unit) {
    Object.assign(this.spec, { title, unit });
    this.head.querySelector("b").textContent = `${title}, ${unit}`;
  }

  size() { return sizeIn(this.plotAt); }
  resize() { this.plot.setSize(this.size()); }
  remove() { this.cursors.charts.delete(this); if (Chart.current === this) Chart.current = null; this.plot.destroy(); this.figure.remove(); }
  redraw() { this.plot.redraw(false); this.tellCursors(); }

  build() {
    const scale = this.plot ? this.plot.scales.x : null, before = scale && scale.min != null ? { min: scale.min, max: scale.max } : null;
    if (this.plot) this.plot.destroy();
    const { series, bands } = this.series(), own = this;
    this.plot = new uPlot({
      ...this.size(), series, bands, legend: { show: false }, pxAlign: 0, padding: [8, 14, 0, 0],
      scales: { x: { time: false, range: (u, low, high) => this.xShown(low, high) }, y: { distr: this.log ? 3 : 1, range: (u, low, high) => this.yShown(low, high) }, ...this.moreScales() },
      axes: [axisOf(26, (t) => `${+t.toPrecision(7)} ${this.spec.x.unit}`.trim()), axisOf(58, (t) => String(+t.toPrecision(6))), ...this.moreAxes()],
      cursor: { ...(this.view.sync ? { sync: { key: this.view.sync } } : {}), points: this.points(), drag: { x: true, y: false, setScale: false }, bind: { dblclick: () => () => { own.reset(); return null; } } },
      hooks: {
        setSelect: [(u) => {
          if (u.select.width > 4) own.select(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
          u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        }],
        setCursor: [(u) => own.read(u)], draw: [(u) => own.drawCursors(u)],
      },
    }, this.data || series.map(() => []), this.plotAt);
    let pressed = null;
    this.plot.over.addEventListener("mousedown", (e) => { pressed = e.clientX; });
    this.plot.over.addEventListener("click", (e) => { if (pressed !== null && Math.abs(e.clientX - pressed) < 3 && e.detail < 2) own.cursors.click(own.nearest(own.plot.posToVal(e.clientX - own.plot.over.getBoundingClientRect().left, "x"))); });
    if (this.data && before) this.plot.setScale("x", before);
  }

  series() {
    const line = (s, i) => ({ label: s.label, stroke: cssColour(`--series-${s.colour}`), width: s.width, dash: s.dash, points: { show: false }, show: !this.off.has(i), scale: s.scale || "y" });
    return { series: [{}, ...this.spec.series.map(line)], bands: [] };
  }
  points() { return {}; }
  moreScales() { return {}; }
  moreAxes() { return []; }
  columnOf(i) { return i + 1; } // of `data`, of series i
  xShown(low, high) { return [low, high]; }

  yShown(low, high) {
    if (this.yRange) return this.yRange;
    if (low == null || high == null) return this.log ? [1e-3, 1] : [0, 1];
    if (low === 0 && high === 0 && !this.log) return [-1, 1]; // uPlot would show 0 to 100
    return this.log ? uPlot.rangeLog(low, high, 10, false) : uPlot.rangeNum(low, high, 0.1, true);
  }

  // the range of the abscissa; subclasses with their own override it
  select(from, to) { this.view.select(from, to); }
  reset() { this.setY(null); this.view.reset(); }
  panX(share) { this.view.pan(share); }
  zoomX(factor) { this.view.zoom(factor); }

  setY(range) {
    this.yRange = range;
    this.auto.hidden = !range;
    this.plot.batch(() => { const { min, max } = this.plot.scales.x; this.plot.setData(this.plot.data, false); if (min != null) this.plot.setScale("x", { min, max }); });
    this.view.changed();
  }

  mapY(way) {
    const { min, max } = this.plot.scales.y;
    if (min == null) return;
    if (!this.log) this.setY([way(min, min, max), way(max, min, max)]);
    else { const [l, h] = [Math.log(min), Math.log(max)]; this.setY([Math.exp(way(l, l, h)), Math.exp(way(h, l, h))]); }
  }

  // about a point in the height of the plot, 0 at its bottom
  zoomY(factor, share = 0.5) { this.mapY((v, min, max) => { const middle = min + share * (max - min); return middle + (v - middle) * factor; }); }
  panY(share) { this.mapY((v, min, max) => v + share * (max - min)); }

  place(e) {
    const box = this.plot.over.getBoundingClientRect();
    return { left: (e.clientX - box.left) / box.width, up: 1 - (e.clientY - box.top) / box.height, onValues: e.clientX < box.left };
  }

  // the wheel scrolls the page; over the axis numbers, or with Shift, it zooms the values; with Ctrl the abscissa
  wheel(e) {
    const { up, onValues } = this.place(e), factor = (e.deltaY || e.deltaX) > 0 ? WHEEL_ZOOM : 1 / WHEEL_ZOOM;
    if (!onValues && !e.shiftKey && !e.ctrlKey) return;
    e.preventDefault();
    if (e.ctrlKey) this.zoomX(factor); else this.zoomY(factor, Math.min(1, Math.max(0, up)));
  }

  // dragging the axis numbers moves the values; Shift and dragging the plot moves both
  grab(e) {
    const { onValues } = this.place(e);
    if (e.button !== 0 || (!onValues && !e.shiftKey)) return;
    e.preventDefault(); e.stopPropagation();
    let { clientX, clientY } = e;
    const { width, height } = this.plot.over.getBoundingClientRect();
    const move = (m) => {
      if (m.clientY !== clientY) this.panY((m.clientY - clientY) / height);
      if (!onValues && m.clientX !== clientX) this.panX((clientX - m.clientX) / width);
      ({ clientX, clientY } = m);
    };
    const end = () => { removeEventListener("mousemove", move); removeEventListener("mouseup", end); };
    addEventListener("mousemove", move);
    addEventListener("mouseup", end);
  }

  // returns whether the chart used the key
  key(e) {
    const shift = e.shiftKey && (e.key === "ArrowLeft" ? -1 : e.key === "ArrowRight" ? 1 : 0);
    if (shift) this.moveCursor(shift);
    else if (e.key === "ArrowUp") this.panY(PAN_SHARE);
    else if (e.key === "ArrowDown") this.panY(-PAN_SHARE);
    else if (e.key === "PageUp") this.zoomY(1 / WHEEL_ZOOM);
    else if (e.key === "PageDown") this.zoomY(WHEEL_ZOOM);
    else if (e.key === "y") this.setY(null);
    else if (e.key === "a" || e.key === "b") this.putCursor(e.key);
    else if (e.key === "Delete") this.cursors.clear();
    else return false;
    return true;
  }

  // cursors

  nearest(x) {
    const at = this.plot.data[0];
    return at.length ? at[this.plot.valToIdx(x)] : x;
  }

  putCursor(name) {
    const { min: from, max: to } = this.plot.scales.x, at = this.plot.data[0];
    if (from == null) return;
    const [min, max] = at.length ? [Math.max(from, at[0]), Math.min(to, at[at.length - 1])] : [from, to]; // where there are points
    const mouse = this.plot.cursor.left >= 0 ? this.plot.posToVal(this.plot.cursor.left, "x") : null, now = this.cursors.at[name];
    const free = now !== null && now >= min && now <= max ? now : min + (name === "a" ? 1 : 2) / 3 * (max - min);
    this.cursors.set(name, this.nearest(mouse === null ? free : mouse));
  }

  moveCursor(direction) {
    const name = this.cursors.active, { min, max } = this.plot.scales.x, now = this.cursors.at[name], at = this.plot.data[0];
    if (now === null) { this.putCursor(name); return; }
    let to = this.nearest(now + direction * (max - min) / CURSOR_STEPS);
    if (to === now && at.length) to = at[Math.min(at.length - 1, Math.max(0, this.plot.valToIdx(now) + direction))];
    this.cursors.set(name, Math.min(max, Math.max(min, to)));
  }

  // value of series i at a cursor
  valueAt(i, x) {
    const { data } = this.plot;
    if (!data[0].length || x < data[0][0] || x > data[0][data[0].length - 1]) return null;
    return data[this.columnOf(i)][this.plot.valToIdx(x)];
  }

  drawCursors(u) {
    const { ctx, bbox } = u;
    for (const name of ["a", "b"]) {
      const x = this.cursors.at[name], { min, max } = u.scales.x;
      if (x === null || min == null || x < min || x > max) continue;
      const left = u.valToPos(x, "x", true), pixels = devicePixelRatio;
      ctx.save();
      ctx.strokeStyle = ctx.fillStyle = cssColour("--text");
      ctx.lineWidth = pixels * (name === this.cursors.active ? 1.6 : 1);
      ctx.setLineDash(name === "a" ? [] : [6 * pixels, 3 * pixels]);
      ctx.beginPath(); ctx.moveTo(left, bbox.top); ctx.lineTo(left, bbox.top + bbox.height); ctx.stroke();
      ctx.font = `${12 * pixels}px system-ui, sans-serif`;
      const right = left > bbox.left + bbox.width - 16 * pixels;
      ctx.textAlign = right ? "right" : "left";
      ctx.fillText(name.toUpperCase(), left + (right ? -3 : 3) * pixels, bbox.top + 11 * pixels);
      ctx.restore();
    }
  }

  xText(x) { return `${shown(x, 6)} ${this.spec.x.unit}`.trim(); }

  tellCursors() {
    const { a, b } = this.cursors.at;
    this.cursorLine.hidden = a === null && b === null;
    if (this.cursorLine.hidden) return;
    const parts = [a !== null && `A ${this.xText(a)}`, b !== null && `B ${this.xText(b)}`], both = a !== null && b !== null;
    if (both) parts.push(`B−A ${this.xText(b - a)}${this.spec.x.inverse && a !== b ? `, 1/(B−A) ${shown(1 / Math.abs(b - a), 4)} ${this.spec.x.inverse}` : ""}`);
    this.spec.series.forEach((s, i) => {
      if (this.off.has(i)) return;
      const [low, high] = [a, b].map((x) => (x === null ? null : this.valueAt(i, x)));
      parts.push(`${s.label} ${[a !== null && shown(low, 4), b !== null && shown(high, 4)].filter(Boolean).join(" → ")}${both && low != null && high != null ? `, Δ ${shown(high - low, 4)}` : ""} ${s.unit || this.spec.unit}`);
    });
    this.cursorLine.textContent = parts.filter(Boolean).join(" · ");
  }

  // values at the crosshair of any chart; without one the latest
  read(u) {
    const at = u.cursor.idx;
    this.crossed = at != null && u.cursor.left >= 0;
    if (!this.crossed) return;
    this.spec.series.forEach((s, i) => { const column = u.data[this.columnOf(i)]; this.values[i].textContent = shown(column && column[at]); });
  }
}
Chart.current = null;

// a chart with its own abscissa instead of the shared time
class OwnAxisChart extends Chart {
  constructor(spec, parent, view) { super(spec, parent, view); this.xRange = null; }

  xShown(low, high) { return this.xRange || (low == null || low === high ? [0, 1] : [low, high]); }
  show(data) {
    this.data = data;
    this.plot.setData(data, true);
    this.tellCursors();
  }
  setX(range) { this.xRange = range; this.plot.setData(this.plot.data, true); this.view.changed(); }
  select(from, to) { if (to > from) this.setX([from, to]); }
  reset() { this.cursors.clear(); this.xRange = null; this.setY(null); this.plot.setData(this.plot.data, true); }
  mapX(way) { const { min, max } = this.plot.scales.x; if (min != null) this.setX([way(min, min, max), way(max, min, max)]); }
  panX(share) { this.mapX((v, min, max) => v + share * (max - min)); }
  zoomX(factor) { this.mapX((v, min, max) => (min + max) / 2 + (v - (min + max) / 2) * factor); }

  key(e) {
    if (e.target === this.plotAt) { // only with the focus: otherwise these keys act on the time
      if (e.key === "+" || e.key === "=") { this.zoomX(0.5); return true; }
      if (e.key === "-") { this.zoomX(2); return true; }
      if (e.key === "0") { this.reset(); return true; }
      if (!e.shiftKey && (e.key === "ArrowLeft" || e.key === "ArrowRight")) { this.panX(e.key === "ArrowLeft" ? -0.25 : 0.25); return true; }
    }
    return super.key(e);
  }
}
