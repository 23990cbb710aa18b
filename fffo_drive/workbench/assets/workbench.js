"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const BUSY_MS = 1000, IDLE_MS = 2000;
  const STEP_OF = { commission: "h-axis", accept: "h-checks", record: "h-record", identify: "h-runs", tune: "h-model", diagnose: "h-runs", adopt: "h-model", fleet_add: "h-store", fleet_work: "h-store", fleet_report: "h-fleet-report", fleet_diagnose: "h-fleet-report" };
  const FLEET = ["fleet_add", "fleet_work", "fleet_report", "fleet_diagnose"];
  const chosen = { use: new Set(), hold: new Set(), seen: new Set(), page: "", job: 0 };
  const KIND_OF = { identify: "identify", tune: "tune", diagnose: "diagnose", compare: "evaluate", circle: "close-the-loop" };
  const SAYS = ["adopt", "roll_back", "commission", "accept", "fleet_add", "fleet_work"]; // what they print is the result
  const listeners = [];
  let state = null, timer = 0, answered = null;
  window.fffoWorkbench = { $, advise, ask, confirmed, element, enable, fill, look, options, question, tell, unask, get state() { return state; }, onState(listener) { listeners.push(listener); } };

  async function ask(what, body, raw) {
    const answer = await fetch(what, body === undefined ? {} : { method: "POST", body: raw ? body : JSON.stringify(body) });
    const content = await answer.json();
    if (!answer.ok) throw new Error(content.error || answer.statusText);
    return content;
  }

  async function look() {
    clearTimeout(timer);
    try {
      state = await ask("state");
      $("connection").textContent = "";
      show();
    } catch (error) {
      $("connection").textContent = "no connection to the workbench: the data shown are old";
    }
    timer = setTimeout(look, state && running() ? BUSY_MS : IDLE_MS);
  }

  const running = () => state.jobs.find((job) => job.state === "running");

  function show() {
    axis();
    runs();
    pages();
    job();
    for (const listener of listeners) listener(state);
    enable();
    advise();
  }

  function advise() {
    const step = next();
    $("next").textContent = step ? step.text : "";
    for (const section of document.querySelectorAll(".steps section")) section.classList.toggle("now", Boolean(step) && section.getAttribute("aria-labelledby") === STEP_OF[step.act]);
  }

  function enable() {
    for (const button of document.querySelectorAll("[data-act]")) button.disabled = !possible(button.dataset.act);
  }

  function possible(act) {
    if (running() || !state.may.includes(act)) return false;
    if (["commission", "accept", "record", "circle", "roll_back", "adopt"].includes(act) && (!state.axis || state.axis.error)) return false;
    if (["commission", "circle"].includes(act) && state.daemon) return false; // it opens the bus itself
    if (act === "commission") return state.axis.on_bus;
    if (FLEET.includes(act) && !(window.fffoFleet.state && (act === "fleet_add" ? window.fffoFleet.state.store : window.fffoFleet.state.runs))) return false;
    if (["identify", "diagnose", "compare", "fleet_add"].includes(act)) return chosen.use.size > 0;
    if (["tune", "adopt"].includes(act)) return Boolean($("model").value);
    return true;
  }

  // what somebody who is new here would do next
  function next() {
    if (running()) return null;
    if (!$("fleet").hidden) return window.fffoFleet.next();
    const results = axisPages(), kinds = results.map((page) => page.kind);
    if (state.axis && state.axis.commissioning && state.daemon) return { act: "", text: "Next: stop the daemon, then commission the axis" };
    if (state.axis && state.axis.commissioning) return { act: "commission", text: `Next: commission the axis${state.axis.simulated ? ", once its simulated drive runs (tab Axis)" : ""}` };
    if (!state.runs.length) return { act: "record", text: "Next: record a run, or add a file" };
    if (kinds[0] === "diagnose") {
      const page = results[0];
      return page.next_step === "adopt it" && state.axis ? { act: "adopt", text: "Next: show the gates, and adopt what was found" } : { act: "", text: `Next: ${page.next_step}` };
    }
    if (!kinds.includes("diagnose") && !kinds.includes("close-the-loop")) {
      if (state.runs.length < 3 && state.axis) return { act: "record", text: "Next: record profile, identification current and recipe" };
      return { act: "diagnose", text: "Next: tick the runs, hold one out, diagnose" };
    }
    return results.length ? { act: "", text: `Next: ${results[0].next_step}` } : null;
  }

  function axis() {
    const found = state.axis;
    $("where").textContent = `${state.directory}; role: ${state.role}`;
    $("title").textContent = found ? found.name : "Recordings";
    document.title = `${$("title").textContent}: workbench`;
    $("axis-error").hidden = !found || !found.error;
    if (found && found.error) $("axis-error").textContent = found.error;
    const rows = !found ? [["axis", "none: recordings only"]] : found.error ? [["file", found.shown]] : [
      ["file", found.shown], ["drive", `${found.drive}, ${found.rate_hz} Hz`], ["model", found.model], ["gains", found.gains], ["profile", found.profile],
      ["effects", found.effects.map((e) => e.name + (e.reason ? ` (not compensated: ${e.reason})` : "")).join(", ") || "none"],
      ...(found.commissioning ? [["commissioning", found.commissioning]] : [])];
    if (state.facts) rows.push(["declared facts", state.facts]);
    fill($("axis-facts"), rows.flatMap(([name, text]) => [element("dt", name), element("dd", text)]));
    $("axis-choice").hidden = state.axis_files.length < 2;
    options($("axis-file"), state.axis_files.map((path) => [path, path.split("/").slice(-2).join("/")]), found ? found.path : "");
    $("axis-file").disabled = !state.may.includes("tune");
  }

  function runs() {
    for (const run of state.runs) if (!chosen.seen.has(run.path)) { chosen.seen.add(run.path); chosen.use.add(run.path); }
    $("no-runs").hidden = state.runs.length > 0;
    const body = $("runs").tBodies[0], key = JSON.stringify(state.runs);
    if (body.dataset.key === key) return;
    body.dataset.key = key;
    fill(body, state.runs.map((run) => {
      const row = document.createElement("tr");
      const use = box(`use ${run.name}`, chosen.use, run.path), hold = box(`hold ${run.name} out`, chosen.hold, run.path);
      use.onchange = () => { set(chosen.use, run.path, use.checked); if (use.checked) { chosen.hold.delete(run.path); hold.checked = false; } show(); };
      hold.onchange = () => { set(chosen.hold, run.path, hold.checked); if (hold.checked) { chosen.use.delete(run.path); use.checked = false; } show(); };
      for (const content of [use, hold, run.name, String(run.megabytes)]) row.insertCell().append(content);
      return row;
    }));
  }

  const axisPages = () => state.pages.filter((page) => !page.kind.startsWith("fleet")); // those have their tab

  function pages() {
    const results = axisPages();
    $("no-pages").hidden = results.length > 0;
    options($("model"), state.pages.filter((page) => page.model).map((page) => [page.model, `${page.name}: ${page.finding}`]), $("model").value);
    const body = $("pages").tBodies[0], key = JSON.stringify(results) + chosen.page;
    if (body.dataset.key === key) return;
    body.dataset.key = key;
    fill(body, results.map((page) => {
      const row = document.createElement("tr"), button = element("button", page.name);
      button.type = "button";
      button.onclick = () => open(page);
      row.classList.toggle("shown", page.page === chosen.page);
      for (const content of [button, page.finding, page.confidence, page.next_step]) row.insertCell().append(content);
      return row;
    }));
  }

  function open(page) {
    chosen.page = page.page;
    $("headline").textContent = page.headline;
    $("viewer").hidden = false;
    $("viewer").src = `files/${page.page}`;
    if (page.model) $("model").value = page.model;
    show();
  }

  function job() {
    const now = state.jobs[0];
    if (!now) return;
    const works = now.state === "running";
    $("job-title").textContent = `${now.title[0].toUpperCase()}${now.title.slice(1)}`;
    $("job-state").textContent = `${now.state}, ${now.seconds} s${works && now.step ? `: ${now.step}` : ""}${works && now.share !== null ? ` ${Math.round(100 * now.share)} %` : ""}`;
    $("job-share").hidden = !works;
    if (now.share === null) $("job-share").removeAttribute("value"); else $("job-share").value = now.share;
    $("job-line").textContent = now.line;
    $("job-output").textContent = now.output.join("\n");
    $("cancel").hidden = !works || !state.may_cancel;
    if (works || now.number !== chosen.job) return;
    chosen.job = 0; // it was asked for here, and has just ended
    $("job-output-fold").open = now.state !== "done" || SAYS.includes(now.action);
    const kind = KIND_OF[now.action], page = state.pages.find((one) => one.kind === kind);
    if (now.state === "done" && page) open(page);
  }

  function wish(button) {
    const act = button.dataset.act;
    if (act === "record") return { motion: $("motion").value, toggle: $("toggle").value };
    if (act === "circle") return { quick: $("quick").checked };
    if (act === "identify" || act === "compare" || act === "fleet_add") return { fit: [...chosen.use] };
    if (act === "fleet_report" || act === "fleet_diagnose") return { alarms_per_drive_year: Number($("fleet-rate").value), serial: $("fleet-serial").value.trim() };
    if (act === "diagnose") return { fit: [...chosen.use], held_out: [...chosen.hold] };
    if (act === "tune") return { model: $("model").value };
    if (act === "adopt") return { model: $("model").value, dry_run: Boolean(button.dataset.dry) };
    return {};
  }

  // resolves with whether it may be; `what` completes "The axis NAME will ..."
  function confirmed(what) {
    return question(`The axis ${state.axis.name} will ${what}. Is everybody out of its reach, and the emergency stop at hand?`, "Move it", "Do not");
  }

  // resolves with true, false, "all" where that is offered, or null once the question is no more
  function question(text, yes, no, all) {
    unask();
    $("ask-text").textContent = text;
    $("ask-yes").textContent = yes;
    $("ask-no").textContent = no;
    $("ask-all").textContent = all || "";
    $("ask-all").hidden = !all;
    return new Promise((done) => {
      answered = (answer) => { answered = null; $("ask").close(); done(answer); };
      $("ask").showModal();
      $("ask-no").focus();
    });
  }

  function unask() { if (answered) answered(null); }

  for (const [id, answer] of [["ask-yes", true], ["ask-all", "all"], ["ask-no", false]]) $(id).onclick = () => answered && answered(answer);
  $("ask").oncancel = () => answered && answered(false);

  async function tell(work) {
    $("said").textContent = "";
    try { await work(); } catch (error) { $("said").textContent = error.message; }
    await look();
  }

  for (const button of document.querySelectorAll("[data-act]")) button.onclick = () => tell(async () => {
    const moves = state.moves.includes(button.dataset.act) && state.axis.on_bus;
    if (!moves || await confirmed("move")) chosen.job = (await ask(button.dataset.act, wish(button))).number;
  });
  $("cancel").onclick = () => tell(() => ask("cancel", {}));
  $("axis-file").onchange = () => tell(() => ask("use_axis", { path: $("axis-file").value }));
  $("take").onchange = () => tell(async () => {
    for (const file of $("take").files) await ask(`take?name=${encodeURIComponent(file.name)}`, file, true);
    $("take").value = "";
  });

  // small helpers
  function element(tag, text) { const made = document.createElement(tag); made.textContent = text; return made; }
  function fill(parent, children) { parent.replaceChildren(...children); }
  function set(of, value, on) { if (on) of.add(value); else of.delete(value); }
  function box(label, of, value) {
    const made = document.createElement("input");
    made.type = "checkbox";
    made.checked = of.has(value);
    made.setAttribute("aria-label", label);
    return made;
  }
  function options(select, pairs, value) {
    const key = JSON.stringify(pairs);
    if (select.dataset.key !== key) {
      select.dataset.key = key;
      fill(select, pairs.map(([given, text]) => new Option(text, given)));
    }
    if (pairs.some(([given]) => given === value)) select.value = value;
  }

  // tabs: the arrow keys go from one to the other, as everywhere
  const tabs = [...document.querySelectorAll("[role=tab]")];
  function turnTo(tab) {
    for (const one of tabs) {
      const on = one === tab;
      one.setAttribute("aria-selected", String(on));
      one.tabIndex = on ? 0 : -1;
      const panel = $(one.getAttribute("aria-controls")), place = panel.querySelector("[data-jobs]");
      panel.hidden = !on;
      if (on && place) place.prepend($("job")); // one job runs at a time, seen where it is asked for
    }
    if (state) advise(); // of what the tab knows already
    look();
  }
  for (const tab of tabs) {
    tab.onclick = () => turnTo(tab);
    tab.onkeydown = (e) => {
      if (e.key !== "ArrowLeft" && e.key !== "ArrowRight") return;
      const next = tabs[(tabs.indexOf(tab) + (e.key === "ArrowRight" ? 1 : tabs.length - 1)) % tabs.length];
      turnTo(next);
      next.focus();
    };
  }

  look();
})();
