/* Draws series, spans and levels on a uPlot canvas, each series in the style that it comes with. */
const Paint = (() => {
  "use strict";

  const styles = getComputedStyle(document.documentElement);
  const variable = (name) => styles.getPropertyValue("--" + name).trim();
  const TEXT_PX = 12;
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
    let pen = false, missing = 0, column = NaN, low = 0, high = 0, last = 0;
    const flush = () => { ctx.lineTo(column, low); ctx.lineTo(column, high); ctx.lineTo(column, last); };
    for (let i = from; i < to; i++) {
      if (Number.isNaN(s.y[i])) {
        if (++missing > s.bridged && pen) { if (dense) flush(); pen = false; column = NaN; }
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

  function outline(ctx, corners, x, y, px) {
    ctx.beginPath();
    for (const [right, up] of corners) ctx.lineTo(x + right * px, y - up * px);
    ctx.closePath();
  }

  /* Lines across a bar. */
  function hatch(ctx, slopes, left, top, width, height, px) {
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    ctx.strokeStyle = variable("paper");
    ctx.lineWidth = px;
    ctx.beginPath();
    for (const slope of slopes)
      for (let y = top - width; y < top + height + width; y += 6 * px) { ctx.moveTo(left, y); ctx.lineTo(left + width, y - slope * width); }
    ctx.stroke();
    ctx.restore();
  }

  function whisker(ctx, x, low, high, px) {
    ctx.beginPath();
    ctx.moveTo(x, low); ctx.lineTo(x, high);
    for (const y of [low, high]) { ctx.moveTo(x - 3 * px, y); ctx.lineTo(x + 3 * px, y); }
    ctx.stroke();
  }

  function drawSeries(u, s) {
    const ctx = u.ctx, { style } = s, colour = variable("series-" + style.colour), px = uPlot.pxRatio, X = mapper(u, "x"), Y = mapper(u, "y");
    const [from, to] = Data.inView(s, u.scales.x.min, u.scales.x.max);
    if (to <= from) return;
    const floor = u.scales.y.distr === 3 ? u.bbox.top + u.bbox.height : Y(0);
    ctx.strokeStyle = ctx.fillStyle = colour;
    ctx.lineWidth = style.width * px;
    ctx.lineJoin = "round";
    ctx.setLineDash(style.dash.map((d) => d * px));
    ctx.beginPath();
    if (s.draw === "line") { traceLine(ctx, s, from, to, X, Y); ctx.stroke(); }
    else if (s.edges) {
      traceSteps(ctx, s, from, to, X, Y, floor);
      if (style.opacity) { ctx.globalAlpha = style.opacity; ctx.fill(); ctx.globalAlpha = 1; }
      ctx.stroke();
    } else if (s.draw === "bars") {
      for (let i = from; i < to; i++) {
        const left = X(s.x(i) - s.barWidth / 2), right = X(s.x(i) + s.barWidth / 2);
        const top = Math.min(floor, Y(s.y[i])), high = Math.abs(floor - Y(s.y[i]));
        ctx.fillRect(left, top, right - left, high);
        hatch(ctx, style.hatch, left, top, right - left, high, px);
      }
    } else {
      ctx.fillStyle = style.hollow ? variable("paper") : colour;
      for (let i = from; i < to; i++) {
        if (Number.isNaN(s.y[i])) continue;
        outline(ctx, style.marker, X(s.x(i)), Y(s.y[i]), px);
        ctx.fill();
        if (style.hollow) ctx.stroke();
      }
    }
    ctx.setLineDash([]);
    if (s.low && s.high) {
      ctx.strokeStyle = style.ends ? variable(style.ends) : colour;
      ctx.lineWidth = 1.2 * px;
      for (let i = from; i < to; i++) if (s.high[i] >= s.low[i]) whisker(ctx, X(s.x(i)), Y(s.low[i]), Y(s.high[i]), px);
    }
  }

  /* Parts of the abscissa, behind everything. */
  function spans(u, figure) {
    const ctx = u.ctx, px = uPlot.pxRatio, X = mapper(u, "x"), { left, top, width, height } = u.bbox;
    ctx.save();
    ctx.font = font(TEXT_PX * px);
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
    ctx.font = font(TEXT_PX * px);
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

  function all(u, figure) {
    const ctx = u.ctx, { left, top, width, height } = u.bbox;
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    for (const s of figure.series) if (s.shown) drawSeries(u, s);
    levels(u, figure);
    ctx.restore();
  }

  /* The sample of a series in the legend. */
  function sample({ style }) {
    const hue = `var(--series-${style.colour})`, stroke = `stroke="${hue}" stroke-width="${style.width}"`;
    const ring = style.marker.map(([right, up]) => `${13 + right},${6 - up}`).join(" ");
    let shape = `<line x1="0" y1="6" x2="26" y2="6" ${stroke} stroke-dasharray="${style.dash.join(" ") || "none"}"/>`;
    if (style.opacity) {
      shape = `<rect x="7" y="1" width="12" height="10" fill="${hue}" fill-opacity="${style.opacity}" ${style.opacity < 1 ? stroke : ""}/>`;
      for (const slope of style.hatch)
        shape += `<path d="${slope < 0 ? "M7 5l6 6M7 1l10 10M13 1l6 6" : "M13 11l6 -6M9 11l10 -10M7 7l6 -6"}" stroke="var(--paper)"/>`;
    } else if (ring) shape = `<polygon points="${ring}" fill="${style.hollow ? "none" : hue}" ${style.hollow ? stroke : ""}/>`;
    return `<svg width="26" height="12" viewBox="0 0 26 12" aria-hidden="true">${shape}</svg>`;
  }

  return { all, spans, sample, variable, font, TEXT_PX };
})();
