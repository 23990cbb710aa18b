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

  /* Figures of a group with one ordinate, of which all move when one does. */
  const sharing = (plot) => (plot.figure.shareY ? inGroup(plot).filter((p) => p.figure.shareY && p.figure.y.text === plot.figure.y.text) : [plot]);
  const isWhole = (plot) => plot.view[0] === plot.figure.x.low && plot.view[1] === plot.figure.x.high;
  /* As the figure is defined, and as it is in a picture: not zoomed, nothing hidden. */
  const asDefined = (plot) => isWhole(plot) && sharing(plot).every((p) => p.figure.series.every((s) => s.shown));

  function rangeY(plot) {
    const { figure } = plot, { log } = figure.y;
    if (asDefined(plot)) return [figure.y.low, figure.y.high];
    const found = Data.range(sharing(plot).flatMap((p) => p.figure.series), ...plot.view, log);
    let [min, max] = found || (log ? [0.1, 1] : [0, 1]);
    for (const level of figure.levels) if (!level.upright) { min = Math.min(min, level.value); max = Math.max(max, level.value); }
    if (log) return [10 ** Math.floor(Math.log10(min)), 10 ** Math.ceil(Math.log10(max) - 1e-6)];
    const grounded = figure.kind === "histogram" || figure.kind === "bars"; // they stand on zero, or hang from it
    if (grounded) [min, max] = [Math.min(0, min), Math.max(0, max)];
    const pad = 0.06 * (max - min || Math.abs(max) || 1);
    return [grounded && min === 0 ? 0 : min - pad, grounded && max === 0 && min < 0 ? 0 : max + pad];
  }

  const FOLDED_WIDTH = 600; // until it is unfolded and has one
  const GROUP_AXIS = 52; // figures that zoom together stand with their ordinates one above the other

  /* Ticks of a part that is zoomed: powers of ten, with 1-2-5 between them over less than two decades; else equidistant. */
  function ticks(min, max, step, log) {
    const found = [], fine = max / min < 100 ? [1, 2, 5] : [1];
    if (!log) for (let k = Math.ceil(min / step - 1e-9); k * step <= max + 1e-9 * step; k++) found.push(+(k * step).toPrecision(12));
    else for (let e = Math.floor(Math.log10(min)); e <= Math.ceil(Math.log10(max)); e++)
      for (const f of fine) { const v = f * 10 ** e; if (v >= min * 0.999 && v <= max * 1.001) found.push(v); }
    return found;
  }

  const APART = { x: 60, y: 34 }; // px between two texts beside ticks, at least

  function axis(plot, scale) {
    const { figure } = plot, spec = figure[scale], ordinate = (u, values) => 14 + 6.6 * Math.max(2, ...(values || []).map((v) => (v ? v.length : 0)));
    const texts = new Map(spec.ticks.map((v, i) => [v, spec.texts[i]]));
    const defined = () => spec.named || (scale === "x" ? isWhole(plot) : asDefined(plot));
    const thin = (u, at) => { // on a narrow screen
      const room = scale === "x" ? u.bbox.width / uPlot.pxRatio : u.bbox.height / uPlot.pxRatio;
      const every = spec.named || spec.log && !defined() ? 1 : Math.ceil((at.length - 1) * APART[scale] / Math.max(room, 1) - 0.2);
      return at.map((v, i) => (i % Math.max(1, every) ? null : v));
    };
    return {
      side: scale === "x" ? 2 : 3,
      scale,
      label: spec.text,
      labelSize: 20,
      labelFont: Paint.font(Paint.TEXT_PX),
      font: Paint.font(Paint.TEXT_PX),
      labelGap: scale === "y" ? 2 : 0,
      gap: 4,
      size: scale === "x" ? 28 : figure.group ? GROUP_AXIS : ordinate,
      space: APART[scale],
      stroke: () => Paint.variable("quiet"),
      grid: { show: !spec.named, stroke: () => Paint.variable("grid"), width: 1 },
      ticks: { show: !spec.named, stroke: () => Paint.variable("rule"), width: 1, size: 4 },
      border: { show: true, stroke: () => Paint.variable("rule"), width: 1 },
      splits: (u, index, min, max, step) => (defined() ? spec.ticks : ticks(min, max, step, spec.log)),
      filter: (u, at) => at,
      values: (u, at) => thin(u, at).map((v) => (v === null ? null : texts.get(v) ?? readable(v))),
    };
  }

  /* uPlot sets scales later, in one go: what is in view is therefore kept here. */
  function setX(plot, min, max) {
    const { low, high } = plot.figure.x;
    const width = Math.max(max - min, (high - low) * 1e-5), start = Math.min(Math.max(min, low), high - width);
    for (const other of inGroup(plot)) other.view = width < high - low ? [start, start + width] : [low, high];
    inGroup(plot).forEach(redraw);
  }

  function redraw(plot) {
    const [xMin, xMax] = plot.view, [yMin, yMax] = rangeY(plot);
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
    const [to, back] = bend(plot), [min, max] = plot.view.map(to), [low, high] = [plot.figure.x.low, plot.figure.x.high].map(to);
    const by = Math.min(high - max, Math.max(low - min, share * (max - min)));
    setX(plot, back(min + by), back(max + by));
  }

  const showAll = (plot) => setX(plot, plot.figure.x.low, plot.figure.x.high);

  function readOff(plot) {
    const { u, figure } = plot, left = u.cursor.left;
    const at = left >= 0 ? u.posToVal(left, "x") : NaN;
    plot.readings.forEach(({ s, node }) => {
      const index = s.sorted && Number.isFinite(at) ? Data.nearest(s, at) : -1;
      node.textContent = index >= 0 && index < s.y.length ? readable(s.y[index]) : "";
    });
    const name = figure.x.named && Number.isFinite(at) ? figure.x.texts[Math.min(figure.x.texts.length - 1, Math.max(0, Math.round(at)))] : "";
    const place = figure.kind === "xy" ? `${readable(at)}, ${readable(u.posToVal(u.cursor.top, "y"))}` : `${readable(at)} ${figure.x.unit}`;
    plot.place.textContent = Number.isFinite(at) ? "at " + (name || place) : "";
  }

  function legend(plot, host) {
    plot.place = document.createElement("span");
    plot.place.className = "value";
    plot.readings = plot.figure.series.map((s) => {
      const button = document.createElement("button");
      button.type = "button";
      button.setAttribute("aria-pressed", "true");
      button.innerHTML = Paint.sample(s);
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
      padding: [figure.spans.length ? 20 : 10, 12, 0, 0],
      legend: { show: false },
      scales: {
        x: { time: false, distr: figure.x.log ? 3 : 1, auto: false, range: (u, min, max) => [min, max] },
        y: { distr: figure.y.log ? 3 : 1, auto: false, range: () => rangeY(plot) },
      },
      axes: [axis(plot, "x"), axis(plot, "y")],
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
        draw: [(u) => Paint.all(u, figure)],
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

  function make(encoded) {
    const box = document.getElementById("figure-" + encoded.name), host = box.querySelector(".plot");
    const figure = { ...encoded, series: encoded.series.map(Data.series) };
    const plot = { figure, host, view: [figure.x.low, figure.x.high] };
    made.push(plot);
    legend(plot, box.querySelector(".legend"));
    box.querySelector(".detail").textContent = detail(figure);
    plot.u = new uPlot(options(plot, host.clientWidth || FOLDED_WIDTH), [[...plot.view], [null, null]], host);
    const actions = { in: () => zoom(plot, 0.5), out: () => zoom(plot, 2), all: () => showAll(plot), csv: () => csv(plot) };
    for (const button of box.querySelectorAll("[data-do]")) button.addEventListener("click", actions[button.dataset.do]);
  }

  const makeAll = (figures) => figures.forEach(make);

  return { makeAll, made, zoom, move, showAll, redraw, readOff };
})();
