/* Starts the page: figures, then what acts on all of them: keyboard, wheel, size, light and dark, paper. */
(() => {
  "use strict";

  Plots.makeAll(JSON.parse(document.getElementById("figure-data").textContent));

  function step(plot, direction) {
    const { u } = plot, width = u.over.clientWidth;
    const left = u.cursor.left >= 0 ? u.cursor.left : width / 2;
    u.setCursor({ left: Math.min(width, Math.max(0, left + direction * width / 100)), top: u.over.clientHeight / 2 });
  }

  const keys = {
    "+": (plot) => Plots.zoom(plot, 0.5),
    "=": (plot) => Plots.zoom(plot, 0.5),
    "-": (plot) => Plots.zoom(plot, 2),
    "0": Plots.showAll,
    Escape: Plots.showAll,
    ArrowLeft: (plot, shift) => (shift ? step(plot, -1) : Plots.move(plot, -0.2)),
    ArrowRight: (plot, shift) => (shift ? step(plot, 1) : Plots.move(plot, 0.2)),
  };

  for (const plot of Plots.made) {
    plot.host.addEventListener("keydown", (event) => {
      const act = keys[event.key];
      if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      act(plot, event.shiftKey);
    });
    plot.host.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      Plots.zoom(plot, event.deltaY < 0 ? 0.7 : 1 / 0.7, plot.u.posToVal(plot.u.cursor.left, "x"));
    }, { passive: false });
  }

  const fit = () => Plots.made.forEach((plot) => {
    const width = plot.host.clientWidth;
    if (width > 0 && width !== plot.u.width) plot.u.setSize({ width, height: plot.figure.height });
  });
  const again = () => Plots.made.forEach((plot) => plot.u.redraw(false, true));

  let waiting = 0;
  /* What is folded has no width; paper shows everything. */
  const folds = [...document.querySelectorAll("details.fold")], unfold = document.getElementById("unfold");
  const open = (on) => folds.forEach((fold) => { fold.open = on; });
  unfold.addEventListener("click", () => {
    const on = unfold.getAttribute("aria-pressed") !== "true";
    unfold.setAttribute("aria-pressed", String(on));
    unfold.textContent = on ? "fold everything" : "open everything";
    open(on);
  });
  for (const fold of folds) fold.addEventListener("toggle", () => fold.open && fit());

  new ResizeObserver(() => { cancelAnimationFrame(waiting); waiting = requestAnimationFrame(fit); }).observe(document.querySelector("main"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);

  /* Paper is white, and narrower than a screen. */
  let before = [];
  const paper = (on) => {
    if (on) { before = folds.map((fold) => fold.open); open(true); }
    else folds.forEach((fold, i) => { fold.open = before[i]; });
    document.documentElement.toggleAttribute("data-paper", on);
    if (on) document.documentElement.dataset.paper = "light";
    document.querySelector("main").style.width = on ? "690px" : "";
    fit();
    again();
  };
  addEventListener("beforeprint", () => paper(true));
  addEventListener("afterprint", () => paper(false));
})();
