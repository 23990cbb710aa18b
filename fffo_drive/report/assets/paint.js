/* Draws series, spans and levels on a uPlot canvas. Hue is never the only difference: dash, marker or hatch and name come with it. */
const Paint = (() => {
  "use strict";

  const DASHES = { solid: [], dashed: [6, 4], dotted: [1.5, 3], dashdot: [8, 3, 2, 3] };
  const MARKERS = ["circle", "square", "diamond", "triangle"];
  const HATCHES = [[], [1], [-1], [1, -1]]; // slopes of the lines across a bar
  const styles = getComputedStyle(document.documentElement);
  const variable = (name) => styles.getPropertyValue("--" + name).trim();
  const colour = (s) => variable("series-" + s.colour);
  const font = (px) => `${px}px system-ui, -apple-system, "Segoe UI", "Liberation Sans", Arial, sans-serif`;

  /* Value to canvas pixel of one scale, without uPlot's look-ups for every point. */
  function mapper(u, key) {
    const { min, max, distr } = u.scales[key];
    const { left, top, width, height } = u.bbox;
    const f = distr === 3 ? Math.log10 : (v) => v;
    const low = f(min), span = f(max) - low;
    return key === "x" ? (v) => left + ((f(v) - low) / span) * width : (v) => top + height - ((f(v) - low) / span) * height;
  }

  /* A line through every point, or through the extremes of each pixel column when there are many points to a pixel. */
  function traceLine(ctx, s, from, to, X, Y) {
    const dense = s.sorted && to - from > 4 * Math.abs(X(s.x(to - 1)) - X(s.x(from)));
    const bridged = s.bucket > 1 ? 0 : 20; // a few samples that are missing do not break a line, a stretch of them does
    let pen = false, missing = 0, column = NaN, low = 0, high = 0, last = 0;
    const flush = () => { ctx.lineTo(column, low); ctx.lineTo(column, high); ctx.lineTo(column, last); };
    for (let i = from; i < to; i++) {
      if (Number.isNaN(s.y[i])) {
        if (++missing > bridged && pen) { if (dense) flush(); pen = false; column = NaN; }
        continue;
      }
      missing = 0;
      const x = X(s.x(i)), y = Y(s.y[i]);
      if (!dense) { pen ? ctx.lineTo(x, y) : ctx.moveTo(x, y); pen = true; continue; }
      const here = Math.round(x);
      if (here !== column) {
        if (pen) flush(); else ctx.moveTo(here, y);
        column = here; low = high = y; pen = true;
      }
      low = Math.min(low, y); high = Math.max(high, y); last = y;
    }
    if (dense && pen) flush();
  }

  function traceSteps(ctx, s, from, to, X, Y, floor) {
    ctx.moveTo(X(s.x(from)), floor);
    for (let i = from; i < to; i++) {
      const y = s.y[i] > 0 || floor === Y(0) ? Y(s.y[i]) : floor;
      ctx.lineTo(X(s.x(i)), y);
      ctx.lineTo(X(s.x(i + 1)), y);
    }
    ctx.lineTo(X(s.x(to)), floor);
  }

  function marker(ctx, shape, x, y, r) {
    ctx.beginPath();
    if (shape === "circle") ctx.arc(x, y, r, 0, 2 * Math.PI);
    else if (shape === "square") ctx.rect(x - r, y - r, 2 * r, 2 * r);
    else if (shape === "diamond") { ctx.moveTo(x, y - 1.3 * r); ctx.lineTo(x + 1.3 * r, y); ctx.lineTo(x, y + 1.3 * r); ctx.lineTo(x - 1.3 * r, y); ctx.closePath(); }
    else { ctx.moveTo(x, y - 1.2 * r); ctx.lineTo(x + 1.1 * r, y + r); ctx.lineTo(x - 1.1 * r, y + r); ctx.closePath(); }
  }

  /* Bars that differ without their colours too. */
  function hatch(ctx, number, left, top, width, height, px) {
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    ctx.strokeStyle = variable("paper");
    ctx.lineWidth = px;
    ctx.beginPath();
    for (const slope of HATCHES[number % HATCHES.length])
      for (let y = top - width; y < top + height + width; y += 6 * px) { ctx.moveTo(left, y); ctx.lineTo(left + width, y + slope * width); }
    ctx.stroke();
    ctx.restore();
  }

  function whisker(ctx, x, low, high, px) {
    ctx.beginPath();
    ctx.moveTo(x, low); ctx.lineTo(x, high);
    for (const y of [low, high]) { ctx.moveTo(x - 3 * px, y); ctx.lineTo(x + 3 * px, y); }
    ctx.stroke();
  }

  function drawSeries(u, s, number) {
    const ctx = u.ctx, px = uPlot.pxRatio, X = mapper(u, "x"), Y = mapper(u, "y");
    const [from, to] = Data.inView(s, u.scales.x.min, u.scales.x.max);
    if (to <= from) return;
    const floor = u.scales.y.distr === 3 ? u.bbox.top + u.bbox.height : Y(0);
    ctx.strokeStyle = ctx.fillStyle = colour(s);
    ctx.lineWidth = s.weight * px;
    ctx.lineJoin = "round";
    ctx.setLineDash(DASHES[s.dash].map((d) => d * px));
    ctx.beginPath();
    if (s.draw === "line") { traceLine(ctx, s, from, to, X, Y); ctx.stroke(); }
    else if (s.edges) {
      traceSteps(ctx, s, from, to, X, Y, floor);
      if (s.draw === "filled") { ctx.globalAlpha = 0.35; ctx.fill(); ctx.globalAlpha = 1; ctx.lineWidth = px; }
      ctx.stroke();
    } else if (s.draw === "bars") {
      for (let i = from; i < to; i++) {
        const left = X(s.x(i) - s.barWidth / 2), right = X(s.x(i) + s.barWidth / 2);
        const top = Math.min(floor, Y(s.y[i])), high = Math.abs(floor - Y(s.y[i]));
        ctx.fillRect(left, top, right - left, high);
        hatch(ctx, number, left, top, right - left, high, px);
      }
    } else {
      const r = s.dots ? 1.2 * px : 4 * px;
      for (let i = from; i < to; i++) {
        if (Number.isNaN(s.y[i])) continue;
        marker(ctx, s.dots ? "circle" : MARKERS[number % MARKERS.length], X(s.x(i)), Y(s.y[i]), r);
        ctx.fillStyle = s.dots ? colour(s) : variable("paper");
        ctx.fill();
        if (!s.dots) ctx.stroke();
      }
    }
    ctx.setLineDash([]);
    if (s.low && s.high) {
      ctx.strokeStyle = variable(s.draw === "bars" ? "text" : "series-" + s.colour);
      ctx.lineWidth = 1.2 * px;
      for (let i = from; i < to; i++) if (s.high[i] >= s.low[i]) whisker(ctx, X(s.x(i)), Y(s.low[i]), Y(s.high[i]), px);
    }
  }

  /* Parts of the abscissa, behind everything. */
  function spans(u, figure) {
    const ctx = u.ctx, px = uPlot.pxRatio, X = mapper(u, "x"), { left, top, width, height } = u.bbox;
    ctx.save();
    ctx.font = font(12 * px);
    for (const span of figure.spans) {
      const a = Math.max(left, X(span.start)), b = Math.min(left + width, X(span.end));
      if (b <= a) continue;
      ctx.fillStyle = variable("grid");
      ctx.fillRect(a, top, b - a, height);
      ctx.fillStyle = variable("quiet");
      ctx.textAlign = "center";
      ctx.fillText(span.label, (a + b) / 2, top - 4 * px);
    }
    ctx.restore();
  }

  function levels(u, figure) {
    const ctx = u.ctx, px = uPlot.pxRatio, { left, top, width, height } = u.bbox;
    ctx.strokeStyle = variable("text");
    ctx.lineWidth = px;
    ctx.font = font(11 * px);
    ctx.textBaseline = "middle";
    const say = (text, x, y) => {
      const wide = ctx.measureText(text).width + 6 * px, from = ctx.textAlign === "left" ? x - 3 * px : x - wide + 3 * px;
      ctx.globalAlpha = 0.85;
      ctx.fillStyle = variable("paper");
      ctx.fillRect(from, y - 8 * px, wide, 15 * px);
      ctx.globalAlpha = 1;
      ctx.fillStyle = variable("text");
      ctx.fillText(text, x, y);
    };
    for (const level of figure.levels) {
      const p = Math.round(mapper(u, level.upright ? "x" : "y")(level.value)) + 0.5;
      ctx.setLineDash([4 * px, 3 * px]);
      ctx.beginPath();
      if (level.upright) { ctx.moveTo(p, top); ctx.lineTo(p, top + height); } else { ctx.moveTo(left, p); ctx.lineTo(left + width, p); }
      ctx.stroke();
      ctx.setLineDash([]);
      const beyond = level.upright && p > left + 0.6 * width;
      ctx.textAlign = level.upright && !beyond ? "left" : "right";
      if (level.upright) say(level.label, p + (beyond ? -5 : 5) * px, top + 12 * px);
      else say(level.label, left + width - 5 * px, p - 9 * px);
    }
  }

  /* Names at the right end of their lines, pushed apart where they would meet. */
  function names(u, all) {
    const ctx = u.ctx, px = uPlot.pxRatio, Y = mapper(u, "y"), { left, top, width, height } = u.bbox;
    const labels = [];
    for (const s of all) {
      const [from, to] = Data.inView(s, u.scales.x.min, u.scales.x.max);
      let i = to - 1;
      while (i >= from && Number.isNaN(s.y[i])) i--;
      if (i >= from) labels.push({ s, y: Math.min(top + height, Math.max(top, Y(s.y[i]))) });
    }
    labels.sort((a, b) => a.y - b.y);
    const pitch = 14 * px;
    for (let i = 1; i < labels.length; i++) labels[i].y = Math.max(labels[i].y, labels[i - 1].y + pitch);
    let bottom = top + height;
    for (let i = labels.length - 1; i >= 0; i--) { labels[i].y = Math.min(labels[i].y, bottom); bottom = labels[i].y - pitch; }
    ctx.font = font(12 * px);
    ctx.textAlign = "left";
    ctx.textBaseline = "middle";
    for (const { s, y } of labels) {
      ctx.fillStyle = colour(s);
      ctx.fillText(s.name, left + width + 6 * px, y);
    }
  }

  function all(u, figure, named) {
    const ctx = u.ctx, { left, top, width, height } = u.bbox;
    const shown = figure.series.filter((s) => s.shown);
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    figure.series.forEach((s, number) => { if (s.shown) drawSeries(u, s, number); });
    levels(u, figure);
    ctx.restore();
    ctx.save();
    if (named) names(u, shown);
    ctx.restore();
  }

  /* The sample of a line in the legend. */
  function sample(s, number) {
    const attributes = `stroke="var(--series-${s.colour})" fill="none" stroke-width="${Math.max(1.6, s.weight)}"`;
    let shape = `<line x1="0" y1="6" x2="26" y2="6" ${attributes} stroke-dasharray="${DASHES[s.dash].join(" ") || "none"}"/>`;
    if (s.draw === "bars" || s.draw === "filled") {
      shape = `<rect x="7" y="1" width="12" height="10" fill="var(--series-${s.colour})"/>`;
      if (s.draw === "bars") for (const slope of HATCHES[number % HATCHES.length])
        shape += `<path d="${slope > 0 ? "M7 5l6 6M7 1l10 10M13 1l6 6" : "M13 11l6 -6M9 11l10 -10M7 7l6 -6"}" stroke="var(--paper)"/>`;
    }
    else if (s.draw === "points") {
      const kind = s.dots ? "circle" : MARKERS[number % MARKERS.length];
      const paths = { circle: "M9 6a4 4 0 1 0 8 0a4 4 0 1 0-8 0", square: "M9 2h8v8h-8z", diamond: "M13 1l5 5l-5 5l-5-5z", triangle: "M13 1.5l4.5 9h-9z" };
      shape = `<path d="${paths[kind]}" ${attributes}/>`;
    }
    return `<svg width="26" height="12" viewBox="0 0 26 12" aria-hidden="true">${shape}</svg>`;
  }

  function nameWidth(all) {
    const ctx = document.createElement("canvas").getContext("2d");
    ctx.font = font(12);
    return Math.max(...all.map((s) => ctx.measureText(s.name).width));
  }

  return { all, spans, sample, variable, font, nameWidth };
})();
