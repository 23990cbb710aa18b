"use strict";
// A picture of a few lines over time, with its values at the crosshair below.

// series: [{label, colour, dash, values}], unit: of the values; describes itself for who cannot see it
function linePlot(parent, title, unit, timeS, series) {
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const axis = (size) => ({ stroke: colour("--quiet"), grid: { stroke: colour("--grid"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif", size });
  const figure = document.createElement("figure"), caption = document.createElement("figcaption"), at = document.createElement("div");
  caption.textContent = `${title}, ${unit}`;
  at.setAttribute("role", "img");
  at.setAttribute("aria-label", `${title}, ${unit}, over ${(timeS.at(-1) - timeS[0]).toPrecision(3)} s: ${series.map((s) => s.label).join(", ")}`);
  figure.append(caption, at);
  parent.append(figure);
  const lines = series.map((s) => ({ label: s.label, stroke: colour(`--series-${s.colour}`), width: s.width || 1.6, dash: s.dash, points: { show: false }, value: (u, v) => (v == null ? "–" : v.toPrecision(3)) }));
  const options = { width: Math.max(240, parent.clientWidth || 600), height: 200, scales: { x: { time: false } }, axes: [axis(28), axis(52)], series: [{ label: "s", value: (u, v) => (v == null ? "–" : v.toFixed(3)) }, ...lines] };
  const plot = new uPlot(options, [timeS, ...series.map((s) => s.values)], at);
  new ResizeObserver(() => plot.setSize({ width: Math.max(240, parent.clientWidth || 600), height: options.height })).observe(parent);
  return figure;
}
