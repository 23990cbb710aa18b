/* One uPlot for each figure: scales, axes, zoom and cursor are uPlot's, the series are painted by paint.js. */
const Plots = (() => {
  "use strict";

  const made = [];
  const inGroup = (plot) => (plot.figure.group ? made.filter((p) => p.figure.group === plot.figure.group) : [plot]);

  function readable(value) {
    if (!Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    return (size !== 0 && (size < 1e-3 || size >= 1e6) ? value.toExponential(2) : String(+value.toPrecision(5))).replace("-", "−");
  }

  function fullX(figure) {
    if (figure.x.limits) return figure.x.limits;
    if (figure.x.categories.length) return [-0.6, figure.x.categories.length - 0.4];
    const [min, max] = figure.extent;
    const pad = figure.kind === "xy" && !figure.x.log ? 0.03 * (max - min) : 0;
    return [min - pad, max + pad];
  }

  function rangeY(plot, xMin, xMax) {
    const { figure } = plot, whole = xMin <= plot.full[0] && xMax >= plot.full[1];
    if (figure.y.limits && whole) return figure.y.limits;
    const all = figure.shareY ? inGroup(plot).filter((p) => p.figure.shareY && p.figure.y.text === figure.y.text).flatMap((p) => p.figure.series) : figure.series;
    const found = Data.range(all, xMin, xMax, figure.y.log);
    let [min, max] = found || (figure.y.log ? [0.1, 1] : [0, 1]);
    for (const level of figure.levels) if (!level.upright) { min = Math.min(min, level.value); max = Math.max(max, level.value); }
    if (figure.y.log) return [10 ** Math.floor(Math.log10(min)), 10 ** Math.ceil(Math.log10(max) - 1e-6)];
    const grounded = figure.kind === "histogram" || figure.kind === "bars";
    const pad = 0.06 * (max - min || Math.abs(max) || 1);
    return grounded ? [Math.min(0, min), max + pad] : [min - pad, max + pad];
  }

  const FOLDED_WIDTH = 600; // until it is unfolded and has one
  const GROUP_AXIS = 52; // figures that zoom together stand with their ordinates one above the other

  function axis(side, spec, group, extra) {
    const ordinate = group ? GROUP_AXIS : (u, values) => 14 + 6.6 * Math.max(2, ...(values || []).map((v) => (v ? v.length : 0)));
    return {
      side,
      scale: side === 2 ? "x" : "y",
      label: spec.text,
      labelSize: 20,
      labelFont: Paint.font(12),
      font: Paint.font(11.5),
      labelGap: side === 3 ? 2 : 0,
      gap: 4,
      size: side === 2 ? 28 : ordinate,
      stroke: () => Paint.variable("quiet"),
      grid: { stroke: () => Paint.variable("grid"), width: 1 },
      ticks: { stroke: () => Paint.variable("rule"), width: 1, size: 4 },
      ...extra,
    };
  }

  /* Powers of ten in view, and 1-2-5 between them when less than two decades are. */
  function decades(u, number, min, max) {
    const found = [], fine = max / min < 100 ? [1, 2, 5] : [1];
    for (let e = Math.floor(Math.log10(min)); e <= Math.ceil(Math.log10(max)); e++)
      for (const f of fine) { const v = f * 10 ** e; if (v >= min * 0.999 && v <= max * 1.001) found.push(v); }
    return found;
  }

  function axes(figure) {
    const categories = figure.x.categories;
    const named = { splits: () => categories.map((_, i) => i), values: (u, at) => at.map((i) => categories[i]), grid: { show: false }, ticks: { show: false } };
    const minus = (u, splits) => splits.map((v) => (v === null ? null : String(+v.toPrecision(8)).replace("-", "−")));
    const power = (u, splits) => splits.map((v) => (v >= 1e-3 && v < 1e5 ? String(+v.toPrecision(3)) : "1e" + Math.round(Math.log10(v)).toString().replace("-", "−")));
    const kind = (spec, space) => (spec.log ? { splits: decades, filter: (u, splits) => splits, values: power } : { space, values: minus });
    return [axis(2, figure.x, figure.group, categories.length ? named : kind(figure.x, 60)), axis(3, figure.y, figure.group, kind(figure.y, 34))];
  }

  /* uPlot sets scales later, in one go: what is in view is therefore kept here. */
  function setX(plot, min, max) {
    const [low, high] = plot.full;
    const width = Math.min(high - low, Math.max(max - min, (high - low) * 1e-5));
    const start = Math.min(Math.max(min, low), high - width);
    for (const other of inGroup(plot)) other.view = [start, start + width];
    inGroup(plot).forEach(redraw);
  }

  function redraw(plot) {
    const [xMin, xMax] = plot.view, [yMin, yMax] = rangeY(plot, xMin, xMax);
    plot.u.batch(() => {
      plot.u.setScale("x", { min: xMin, max: xMax });
      plot.u.setScale("y", { min: yMin, max: yMax });
    });
  }

  /* On a logarithmic axis shares are shares of decades. */
  const bend = (plot) => (plot.figure.x.log ? [Math.log10, (v) => 10 ** v] : [(v) => v, (v) => v]);

  function zoom(plot, factor, centre) {
    const [to, back] = bend(plot), [min, max] = plot.view.map(to);
    const about = centre === undefined ? (min + max) / 2 : to(centre);
    setX(plot, back(about - (about - min) * factor), back(about + (max - about) * factor));
  }

  function move(plot, share) {
    const [to, back] = bend(plot), [min, max] = plot.view.map(to), [low, high] = plot.full.map(to);
    const by = Math.min(high - max, Math.max(low - min, share * (max - min)));
    setX(plot, back(min + by), back(max + by));
  }

  const showAll = (plot) => setX(plot, ...plot.full);

  function readOff(plot) {
    const { u, figure } = plot, left = u.cursor.left;
    const at = left >= 0 ? u.posToVal(left, "x") : NaN;
    plot.readings.forEach(({ s, node }) => {
      const index = s.sorted && s.draw !== "bars" && Number.isFinite(at) ? Data.nearest(s, at) : -1;
      node.textContent = index >= 0 && index < s.y.length ? readable(s.y[index]) : "";
    });
    const pair = figure.kind === "xy" ? `${readable(at)}, ${readable(u.posToVal(u.cursor.top, "y"))}` : `${readable(at)} ${figure.x.unit}`;
    plot.place.textContent = Number.isFinite(at) && !figure.x.categories.length ? "at " + pair : "";
  }

  function legend(plot, host) {
    plot.place = document.createElement("span");
    plot.place.className = "value";
    plot.readings = plot.figure.series.map((s, number) => {
      const button = document.createElement("button");
      button.type = "button";
      button.setAttribute("aria-pressed", "true");
      button.innerHTML = Paint.sample(s, number);
      button.append(s.name + " ");
      const node = document.createElement("span");
      node.className = "value";
      button.append(node);
      button.addEventListener("click", () => {
        s.shown = !s.shown;
        button.setAttribute("aria-pressed", String(s.shown));
        inGroup(plot).forEach(redraw);
      });
      host.append(button);
      return { s, node };
    });
    host.append(plot.place);
  }

  function options(plot, width) {
    const { figure } = plot;
    return {
      width,
      height: figure.height,
      padding: [figure.spans.length ? 20 : 10, plot.right, 0, 0],
      legend: { show: false },
      scales: {
        x: { time: false, distr: figure.x.log ? 3 : 1, auto: false, range: (u, min, max) => [min, max] },
        y: { distr: figure.y.log ? 3 : 1, auto: false, range: () => rangeY(plot, ...plot.view) },
      },
      axes: axes(figure),
      series: [{}, { show: true, stroke: "transparent", points: { show: false } }],
      cursor: {
        y: figure.kind === "xy",
        points: { show: false },
        drag: { x: true, y: false, setScale: false },
        bind: { dblclick: () => () => showAll(plot) },
        sync: figure.group ? { key: figure.group, scales: ["x", null], setSeries: false } : undefined,
      },
      hooks: {
        drawClear: [(u) => Paint.spans(u, figure)],
        draw: [(u) => Paint.all(u, figure, plot.named)],
        setCursor: [() => readOff(plot)],
        setSelect: [(u) => {
          const { left, width: wide } = u.select;
          u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          if (wide > 4 && u.cursor.event) setX(plot, u.posToVal(left, "x"), u.posToVal(left + wide, "x"));
        }],
      },
    };
  }

  /* What the page kept of the records, said where less than every sample is there. */
  function detail(figure) {
    const coarse = figure.series.filter((s) => s.bucket > 1);
    if (!coarse.length) return "";
    const most = Math.max(...coarse.map((s) => s.bucket));
    return figure.kind === "time" ? `The page holds the extremes of every ${most} samples; the record holds all.` : `Every ${most}th point is drawn.`;
  }

  function csv(plot) {
    const [min, max] = plot.view, lines = [`series,${plot.figure.x.text.replace(/,/g, "")},${plot.figure.y.text.replace(/,/g, "")}`];
    for (const s of plot.figure.series) {
      if (!s.shown) continue;
      const [from, to] = Data.inView(s, min, max);
      for (let i = from; i < to; i++) if (!Number.isNaN(s.y[i])) lines.push(`"${s.name}",${s.x(i)},${s.y[i]}`);
    }
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([lines.join("\n") + "\n"], { type: "text/csv" }));
    link.download = plot.figure.name + ".csv";
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  const named = (figure) => figure.series.length > 1 && figure.series.every((s) => s.draw === "line");

  function make(encoded, right) {
    const box = document.getElementById("figure-" + encoded.name), host = box.querySelector(".plot");
    const figure = { ...encoded, series: encoded.series.map(Data.series) };
    const full = fullX(figure);
    const plot = { figure, host, full, view: full, named: named(figure), right };
    made.push(plot);
    legend(plot, box.querySelector(".legend"));
    box.querySelector(".detail").textContent = detail(figure);
    plot.u = new uPlot(options(plot, host.clientWidth || FOLDED_WIDTH), [[...plot.full], [null, null]], host);
    const actions = { in: () => zoom(plot, 0.5), out: () => zoom(plot, 2), all: () => showAll(plot), csv: () => csv(plot) };
    for (const button of box.querySelectorAll("[data-do]")) button.addEventListener("click", actions[button.dataset.do]);
  }

  /* All figures; room for names at the right is that of the widest one in a group. */
  function makeAll(figures) {
    const room = (figure) => (named(figure) ? Math.ceil(Paint.nameWidth(figure.series)) + 12 : 12);
    for (const figure of figures) {
      const beside = figure.group ? figures.filter((other) => other.group === figure.group) : [figure];
      make(figure, Math.max(...beside.map(room)));
    }
  }

  return { makeAll, made, zoom, move, showAll, redraw, readOff };
})();
