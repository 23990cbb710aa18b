"use strict";
// Commissioning as it goes: each check with its verdict, its number in the range that is ok, and the motion before it.
(() => {
  const bench = window.fffoWorkbench, $ = bench.$;
  const shown = { job: 0, list: [], asked: 0, seen: false, question: "", waits: false };
  const COLUMNS = [["velocity_rps", "velocity, rps", "blue"], ["command_a", "current, A", "orange"]];
  window.fffoChecks = shown; // for tests

  bench.onState(async (state) => {
    const job = state.jobs.find((one) => one.action === "commission");
    if (!job) return;
    ask(job, state);
    if (job.number !== shown.job) {
      Object.assign(shown, { job: job.number, list: [], seen: job.state !== "running" });
      $("checks-list").replaceChildren();
    }
    $("checks").hidden = false;
    if (job.checks > shown.list.length && !shown.busy) {
      shown.busy = true;
      try { for (const check of await bench.ask(`checks/${job.number}/${shown.list.length}`)) add(check); } finally { shown.busy = false; }
    }
    const last = new Map(shown.list.map((check) => [check.name, check.verdict])); // a later result of a check replaces the one before
    const count = (verdict) => [...last.values()].filter((one) => one === verdict).length;
    const bad = count("failed") + count("not_done");
    const passed = job.state === "done", tally = `${count("ok")} ok, ${count("warning")} to look at, ${count("failed")} failed, ${count("not_done")} not done`;
    $("checks-verdict").textContent = job.state === "running" ? `running: ${tally}` : passed ? `passed: ${tally}` : `${job.state === "cancelled" ? "cancelled" : "not passed"}: ${tally}`;
    $("checks-verdict").className = passed || job.state === "running" ? "" : "bad";
    const wanted = passed && !bad && Boolean(state.axis.commissioning) && state.may.includes("accept");
    $("accept").hidden = !wanted;
    if (wanted && !shown.seen && shown.list.length >= job.checks && shown.asked !== job.number) {
      shown.asked = job.number;
      const yes = await bench.question(`Commissioning has passed (${tally}). Name its record in ${state.axis.shown}, so that the axis may be enabled? The rest of the file stays as it is.`, "Write the line", "Not now");
      if (yes) bench.tell(() => bench.ask("accept", {}));
    }
  });

  // before each motion, on every page that may; what another page has answered is not asked any more
  async function ask(job, state) {
    const q = job.question, key = q ? `${job.number} ${q.number}` : "";
    if (key === shown.question || !state.may.includes("commission")) return;
    if (shown.waits) bench.unask();
    shown.question = key;
    if (!q) return;
    shown.waits = true;
    const answer = await bench.question(`The axis ${state.axis.name} will move for ${names(q.checks)}: ${q.text}. Is everybody out of its reach, and the emergency stop at hand?`, "Move it", "Do not", "Move it, and the rest without asking");
    if (shown.question === key) shown.waits = false;
    if (answer !== null) bench.tell(() => bench.ask("answer", { question: q.number, answer: answer === "all" ? "all" : answer ? "yes" : "no" }));
  }

  const names = (checks) => checks.join(", ").replaceAll("_", " ");

  function add(check) {
    shown.list.push(check);
    const before = document.getElementById(`check-${check.name}`), fold = document.createElement("details"), summary = document.createElement("summary");
    fold.id = `check-${check.name}`;
    const verdict = bench.element("b", check.verdict.replace("_", " "));
    verdict.className = check.verdict;
    summary.append(verdict, ` ${check.what}: ${check.text}`);
    fold.append(summary);
    if (check.measured != null) fold.append(bench.element("p", `measured ${number(check.measured)}${unit(check)}, ok is ${range(check)}`), gauge(check));
    if (check.remedy) fold.append(bench.element("p", `→ ${check.remedy}`));
    fold.addEventListener("toggle", () => { if (fold.open && !fold.dataset.drawn) { fold.dataset.drawn = "1"; picture(fold, check); } });
    if (before) before.replaceWith(fold); else $("checks-list").append(fold);
    fold.open = check.verdict === "failed" || check.verdict === "warning";
  }

  const number = (value) => String(Number(value.toPrecision(4)));
  const unit = (check) => (check.unit === "-" ? "" : ` ${check.unit}`);
  const range = (check) => (check.lowest == null ? (check.highest == null ? "any" : `at most ${number(check.highest)}`) : check.highest == null ? `at least ${number(check.lowest)}` : `${number(check.lowest)} to ${number(check.highest)}`) + unit(check);

  // where the number lies: the range that is ok in the middle half
  function gauge(check) {
    const { lowest, highest, measured } = check, space = "http://www.w3.org/2000/svg", svg = document.createElementNS(space, "svg");
    if (lowest == null || highest == null || highest <= lowest) return document.createElement("span");
    const share = Math.min(1, Math.max(0, 0.25 + 0.5 * (measured - lowest) / (highest - lowest)));
    svg.setAttribute("viewBox", "0 0 200 14");
    svg.setAttribute("class", "gauge");
    svg.setAttribute("role", "img");
    svg.setAttribute("aria-label", `${number(measured)} ${measured >= lowest && measured <= highest ? "inside" : "outside"} ${range(check)}`);
    for (const [name, attributes] of [["rect", { x: 0, y: 5, width: 200, height: 4, class: "all" }], ["rect", { x: 50, y: 3, width: 100, height: 8, class: "ok" }], ["rect", { x: 200 * share - 1.5, y: 0, width: 3, height: 14, class: "at" }]]) {
      const shape = document.createElementNS(space, name);
      for (const [key, value] of Object.entries(attributes)) shape.setAttribute(key, value);
      svg.append(shape);
    }
    return svg;
  }

  function picture(fold, check) {
    const motion = check.motion;
    if (!motion.time_s || motion.time_s.length < 2) return;
    for (const [name, label, colour] of COLUMNS) linePlot(fold, label.split(",")[0], label.split(", ")[1], motion.time_s, [{ label, colour, values: motion[name] }]);
  }
})();
