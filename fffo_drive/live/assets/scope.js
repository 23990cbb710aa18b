"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const AT_REST = ["offline", "connected", "ready", "fault"];
  const MEANING = { offline: "no drive answers", connected: "no torque; may not be enabled", ready: "no torque; may be enabled", enabled: "torque, held at standstill", preparing: "torque, held at standstill; a start is being prepared", running: "a profile runs", following: "live set points are followed", stopping: "braking; torque goes off at standstill", fault: "latched: reset, then enable again" };
  const FRAME_MS = 20, SILENT_MS = 1500, STALE_MS = 2500, NUMBERS_MS = 200;
  const ANALYSE_MS = 400; // between two computations on live rows
  const MARGIN_BINS = 2; // a trigger is detected at the end of its bin; its rows begin earlier
  const MOST_SIGNALS = 6; // charts of selected signals
  const ANALYSES = [["spectrum", "Spectrum", "s", Spectrum], ["step", "Step", "t", StepResponse], ["phase", "Phase", "p", Phase]];
  // paused: `view` is the time range of `shown` on display. `held`: rows of a trigger, replaced by the next one.
  // `taken`: the full-rate rows of either
  const scope = { fields: [], store: null, shown: null, view: null, held: null, taken: null, rate: 0, binTicks: 1, constant: null, state: "", seconds: 10, trigger: new Trigger(), late: [], mayCommand: false, unconfirmed: false, asked: 0, stops: 0, analyses: {}, own: new Map() };
  const views = new Views(localStorage), time = new Cursors();
  let pictures = [], histogram = null, dirty = true, drawnMs = 0, costMs = 0, heardMs = 0, numbersMs = 0, computedMs = 0, computeCostMs = 0, again = true;

  const token = location.hash.slice(1) || sessionStorage.getItem("scope-token") || "";
  if (location.hash) { // removed from the address bar, so that no screenshot shows it
    sessionStorage.setItem("scope-token", token);
    history.replaceState(null, "", location.pathname);
  }
  mayStop(Boolean(token));
  $("rights").hidden = Boolean(token);
  const wire = new Wire(token, hear, see, connection);
  const captures = new Captures(wire);
  window.fffoScope = scope; // for tests

  // a stop that nothing has confirmed stays said until the state confirms it
  function say(text, bad) { if (!scope.unconfirmed) { $("said").textContent = text; $("said").className = bad ? "bad" : ""; } }

  // state of the connection: none, open without a message yet, open and silent, with or without the key
  const link = { open: false, may: token ? null : false, heardMs: -Infinity };

  function connection(open) {
    Object.assign(link, { open, may: token ? null : false, heardMs: -Infinity });
    if (!open) captures.broken();
    if (!open) mayCommand(false); // Stop stays enabled: it opens a connection
    tellLink();
  }

  function tellLink() {
    const silent = performance.now() - link.heardMs > STALE_MS;
    const text = !link.open ? "no connection to the daemon: the data shown are old"
      : link.heardMs < 0 ? "connected, waiting for the daemon"
      : silent ? `no status for ${((performance.now() - link.heardMs) / 1000).toFixed(0)} s: the data shown are old`
      : link.may === null ? "connected" : link.may ? "connected, with the key" : "connected, view only";
    if ($("connection").textContent !== text) $("connection").textContent = text;
    document.body.classList.toggle("cut", !link.open || (link.heardMs > 0 && silent));
  }
  setInterval(tellLink, 500);

  function rights({ role, may }) { // an old key (the daemon was restarted) gives none
    Object.assign(link, { may: role !== "look", role });
    tellLink();
    mayCommand(may.includes("enable"));
    mayStop(link.may);
    if (link.may) $("rights").textContent = `(role ${role})`;
    $("rights").hidden = role === "tune";
    for (const radio of document.querySelectorAll("input[name=toggle]")) radio.disabled = !may.includes("toggle");
  }

  function mayCommand(may) {
    scope.mayCommand = may;
    $("commands").disabled = !may;
    $("rights").hidden = may || link.may === null; // unknown yet, or not connected: nothing was refused
  }

  function mayStop(may) {
    $("stop").disabled = !may;
    $("may-stop").hidden = !may;
    $("may-look").hidden = may;
  }

  // received messages

  function hear(message) {
    if (message.kind === "hello") hello(message);
    else if (message.kind === "status") status(message.status);
    else if (message.kind === "event") event(message.event);
    else if (message.kind === "loop") loop(message);
    else if (message.kind === "rights") rights(message);
  }

  function hello(message) {
    document.title = `${message.info.axis}: scope`;
    $("axis").textContent = message.info.axis;
    $("profile").replaceChildren(...message.info.profiles.map((name) => new Option(name, name)));
    scope.captureS = message.capture_s;
    if (!pictures.length) {
      scope.fields = message.fields;
      scope.store = new Store(message.fields);
      pictures = [...PICTURES.map((spec) => new Picture(spec, $("pictures"), timeView)), new FrictionMap($("pictures"), ownView())];
      $("trigger-signal").replaceChildren(...message.fields.map((f) => new Option(f.name, f.name)));
      showTrigger();
      $("signal").replaceChildren(new Option("none", ""), ...message.fields.map((f) => new Option(`${f.name}${f.unit && f.unit !== "-" ? ", " + f.unit : ""}`, f.name)));
      histogram = new Histogram($("histogram"), message.lateness_edges_us);
    }
    $("events").replaceChildren();
    message.events.forEach(event);
    loop(message);
    status(message.status);
  }

  function loop(facts) {
    if (facts.loop == null) return;
    if (facts.loop !== scope.loop) { scope.store.clear(); histogram.clear(); scope.late = []; scope.trigger.begin(); }
    Object.assign(scope, { loop: facts.loop, rate: facts.rate_hz, binTicks: facts.bin_ticks, constant: facts.torque_constant_nm_per_a });
  }

  function status(s) {
    link.heardMs = performance.now();
    wire.here();
    tellLink();
    if (scope.unconfirmed && AT_REST.includes(s.state)) {
      scope.unconfirmed = false;
      say(`Stop: the axis is at rest, no torque (confirmed late, by its state: ${s.state})`);
    }
    if (s.state === "fault" && scope.state !== "fault" && scope.state && scope.trigger.settings.kind === "fault") armed(scope.store.now);
    scope.state = s.state;
    scope.epoch = s.epoch;
    document.body.dataset.state = s.state;
    $("state").textContent = s.state.toUpperCase();
    $("meaning").textContent = s.profile && s.state === "running" ? `${s.profile.name}, ${Math.max(0, 100 * s.profile.sample / Math.max(1, s.profile.samples)).toFixed(0)} % of ${s.profile.duration_s.toFixed(1)} s` : (MEANING[s.state] || "") + (s.set_point ? `: ${s.set_point.kind}` : "");
    $("fault").hidden = !s.fault;
    if (s.fault) $("fault").textContent = `Fault: ${s.fault.text} (${s.fault.name})`;
    $("obstacles").textContent = s.obstacles.length ? `Not ready: ${s.obstacles.join("; ")}` : "";
    for (const radio of document.querySelectorAll("input[name=toggle]")) radio.checked = radio.value === s.toggle;
    const recording = s.recording.on ? `recording ${s.recording.rows_written} rows${s.recording.trouble ? ": " + s.recording.trouble : ""}` : "not recording";
    $("facts").textContent = [`friction ${s.toggle}`, `model ${s.model.name}`, `${scope.rate} Hz`, recording, s.drive ? `drive: ${s.drive.state}` : "no drive"].join(" · ");
    $("enable").disabled = s.state !== "ready";
    $("disable").disabled = AT_REST.includes(s.state);
    $("start").disabled = s.state !== "enabled";
    $("hold").disabled = !["preparing", "running", "following"].includes(s.state);
    $("reset").disabled = s.state !== "fault";
  }

  function event(e) {
    const item = document.createElement("li");
    item.className = e.level;
    item.textContent = `${e.time.slice(11, 23)} ${e.level === "info" ? "" : e.level.toUpperCase() + " "}${e.text}`;
    $("events").prepend(item);
    while ($("events").children.length > 50) $("events").lastChild.remove();
  }

  function see(buffer) {
    const { head, at } = takeApart(buffer);
    if (head.kind === "capture") { captures.heard(head, buffer.slice(at)); return; }
    if (!scope.store || head.loop !== scope.loop) return;
    heardMs = performance.now();
    const values = new Float64Array(buffer, at), width = scope.fields.length * 3;
    scope.store.add(values, head.bins, scope.rate, scope.binTicks);
    for (let i = 0; i < head.bins; i++) {
      const bin = values.subarray(i * width, (i + 1) * width);
      if (scope.trigger.sees(bin, scope.store.index)) armed(bin[scope.store.index.tick * 3 + 2] / scope.rate);
    }
    histogram.add(head.lateness);
    scope.late.push([head.ticks, head.late]);
    if (scope.late.length > 250) scope.late.shift();
    dirty ||= head.bins > 0;
    const { pending, settings } = scope.trigger;
    if (pending && !pending.taking && scope.store.now >= pending.until) fire();
    if (settings.mode === "auto" && scope.held && !pending && scope.store.now - scope.held.view[1] > Math.max(AUTO_S, scope.seconds)) release();
  }

  // trigger: by the axis' own time, so that a busy browser takes the same rows

  function armed(time) {
    const { trigger } = scope;
    if (trigger.pending || scope.view) return;
    const seconds = Math.min(scope.seconds, scope.captureS || 10);
    trigger.pending = { time, seconds, until: time + seconds * (1 - trigger.settings.pre / 100) };
    say(`Trigger: ${trigger.name}; the rest of the window is being taken`);
  }

  // a loop that has ended sends no more: use the rows there are
  setInterval(() => { const { pending } = scope.trigger; if (pending && !pending.taking && !scope.view && performance.now() - heardMs > SILENT_MS) fire(); }, 250);

  async function fire() {
    const { trigger } = scope, { pending } = trigger, margin = MARGIN_BINS * scope.binTicks / scope.rate;
    pending.taking = true;
    const most = scope.captureS || 10;
    const buffer = await captures.take(Math.min(most, pending.seconds + margin), Math.ceil(pending.until * scope.rate));
    if (trigger.pending !== pending) return; // paused, or another trigger was chosen meanwhile
    trigger.pending = null;
    if (!buffer.byteLength || scope.view) { say("The rows of the trigger are no longer stored", true); return; }
    const rows = new RowStore(buffer, scope.fields, scope.rate), signal = TRIGGER_SIGNALS[trigger.settings.kind] || trigger.settings.signal;
    const time = trigger.exact(rows.time, rows.values(signal).map(Number), pending.time), before = pending.seconds * trigger.settings.pre / 100;
    const view = [time - before, time - before + pending.seconds];
    scope.taken = buffer;
    scope.event = time;
    if (trigger.settings.mode === "single") {
      scope.shown = rows;
      pause(view);
      say(`Triggered on ${trigger.name}: paused around it, at the full rate`);
    } else {
      scope.held = { store: rows, view };
      say(`Triggered on ${trigger.name}; the next one replaces it`);
    }
    if (scope.analyses.step) scope.analyses.step.triggered(rows.cut(...view), time);
    again = dirty = true;
  }

  function release() { scope.held = scope.taken = null; again = dirty = true; }

  function showTrigger() {
    const { kind, signal, level, edge, mode, pre } = scope.trigger.settings;
    $("trigger").value = kind; $("trigger-signal").value = signal; $("level").value = level; $("edge").value = edge; $("mode").value = mode; $("pre").value = pre;
    $("level-of").hidden = kind !== "level";
    $("trigger-how").hidden = kind === "none";
  }

  function setTrigger(settings) {
    scope.trigger.set(settings);
    showTrigger();
    changed();
    live();
    say(scope.trigger.on ? `Trigger waits for a ${scope.trigger.name}` : "Trigger off");
  }

  // a level trigger at the middle of a signal's range in the window
  function arm(signal) {
    const [store, from, to] = looked(), [begin, end] = store.between(from, to);
    const low = Math.min(...store.column(signal, 0, begin, end, 1).filter((v) => v != null)), high = Math.max(...store.column(signal, 1, begin, end, 1).filter((v) => v != null));
    if (!(high > low)) { say(`${signal} does not change within the window: enter the trigger level`, true); return; }
    setTrigger({ kind: "level", signal, level: +((low + high) / 2).toPrecision(4) });
  }

  // save the rows on display

  async function save() {
    const buffer = scope.taken || await captures.take(Math.min(scope.seconds, scope.captureS || 10), null);
    const rows = Math.floor(buffer.byteLength / rowBytes(scope.fields));
    if (!rows) { say("No rows to save: the loop does not run", true); return; }
    download(csvParts(buffer, scope.fields), "text/csv", `${$("axis").textContent}_${new Date().toISOString().replace(/[:.]/g, "-")}.csv`);
    say(`Saved ${rows} rows at the full rate`);
  }

  function download(parts, type, name) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob(parts, { type }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  }

  // view

  function looked() {
    if (scope.view) return [scope.shown, ...scope.view];
    if (scope.held) return [scope.held.store, ...scope.held.view];
    return [scope.store, scope.store.now - scope.seconds, scope.store.now];
  }

  function pause(view) {
    const [store, from, to] = looked(), first = !scope.view;
    scope.shown = scope.shown || (store === scope.store ? store.snapshot() : store);
    scope.view = view || [from, to];
    scope.trigger.pending = null;
    $("pause").textContent = "Resume (space)";
    $("pause").setAttribute("aria-pressed", "true");
    document.body.classList.add("paused");
    again = dirty = true;
    if (first && !scope.taken) fetchPaused(from, to);
  }

  // the full-rate rows of the bins, where still stored
  async function fetchPaused(from, to) {
    const { shown } = scope, buffer = await captures.take(Math.min(to - from, scope.captureS || 10), Math.ceil(to * scope.rate));
    if (!buffer.byteLength || scope.shown !== shown) return; // live again
    scope.taken = buffer;
    const rows = new RowStore(buffer, scope.fields, scope.rate);
    if (rows.time[0] <= from + 2 * scope.binTicks / scope.rate) scope.shown = rows; // else the bins reach further back
    again = dirty = true;
  }

  function live() {
    scope.view = scope.shown = scope.held = scope.taken = scope.trigger.pending = null;
    $("pause").textContent = "Pause (space)";
    $("pause").setAttribute("aria-pressed", "false");
    document.body.classList.remove("paused");
    again = dirty = true;
  }

  // return to live with the settings as they were
  function reset() {
    time.clear();
    pictures.forEach((picture) => { if (picture.yRange) picture.setY(null); });
    live();
  }

  function select(from, to) { if (to > from) pause([from, to]); }

  function zoom(factor, shift) {
    const [, from, to] = looked();
    const middle = (from + to) / 2 + shift * (to - from), half = Math.min(60, Math.max(0.002, (to - from) / 2 * factor));
    pause([middle - half, middle + half]);
  }

  const changed = () => { $("view").value = ""; }; // the settings no longer match a saved view
  const timeView = { cursors: time, sync: "scope", select, reset, pan: (share) => zoom(1, share), zoom: (factor) => zoom(factor, 0), changed };
  const ownView = () => ({ changed, arm, again: () => { again = true; }, unitOf: (name) => (scope.fields.find((f) => f.name === name) || {}).unit || "-" });

  // charts of selected signals, and computed ones

  function addSignal(name) {
    const field = scope.fields.find((f) => f.name === name);
    if (!field || scope.own.has(name) || scope.own.size >= MOST_SIGNALS) return;
    const picture = pictureOf(field, $("pictures"), timeView);
    element("button", picture.head, "remove", { type: "button" }).addEventListener("click", () => removeSignal(name));
    scope.own.set(name, picture);
    pictures.push(picture);
    dirty = true;
  }

  function removeSignal(name) {
    pictures = pictures.filter((p) => p !== scope.own.get(name));
    scope.own.get(name).remove();
    scope.own.delete(name);
    $("signal").value = "";
  }

  function analyse(name, on) {
    const [, , , Kind] = ANALYSES.find(([key]) => key === name), there = scope.analyses[name];
    $(`show-${name}`).setAttribute("aria-pressed", String(on));
    if (!on && there) { there.remove(); delete scope.analyses[name]; }
    if (on && !there) {
      scope.analyses[name] = new Kind($("pictures"), ownView(), scope.fields.filter((f) => f.type === "<f8").map((f) => f.name));
      if (name === "step" && scope.taken && scope.event) scope.analyses.step.triggered(new RowStore(scope.taken, scope.fields, scope.rate), scope.event);
    }
    again = true;
  }

  function everyPicture() { return [...pictures, ...Object.values(scope.analyses)]; }

  async function compute() {
    const charts = Object.values(scope.analyses), ms = performance.now();
    if (!charts.length || !scope.store || captures.busy) return;
    const still = scope.view || scope.held;
    if (still ? !again : !again && ms - computedMs < Math.max(ANALYSE_MS, 4 * computeCostMs)) return;
    again = false;
    let rows = null;
    if (still && scope.taken) rows = new RowStore(scope.taken, scope.fields, scope.rate).cut(...looked().slice(1));
    else if (!still) {
      const names = [...new Set(["tick", ...charts.flatMap((chart) => chart.names)])];
      rows = new RowStore(await captures.take(Math.min(scope.seconds, scope.captureS || 10), null, names), Captures.fieldsOf(scope.fields, names), scope.rate);
      if (Object.values(scope.analyses).some((chart) => chart.names.some((name) => !names.includes(name)))) { again = true; return; } // another signal was chosen meanwhile
    }
    const begun = performance.now();
    for (const chart of Object.values(scope.analyses)) chart.take(rows);
    computedMs = performance.now();
    computeCostMs = computedMs - begun;
    scope.computed = (scope.computed || 0) + 1;
  }
  setInterval(compute, 100);

  // saved views

  const keyOf = (picture) => picture.spec.key || picture.spec.title;

  function settings() {
    const all = everyPicture();
    const of = (take) => Object.fromEntries(all.map((p) => [keyOf(p), take(p)]).filter(([, v]) => v));
    return {
      seconds: scope.seconds, signals: [...scope.own.keys()], trigger: { ...scope.trigger.settings },
      off: of((p) => p.off.size && [...p.off].map((i) => p.spec.series[i].label)), values: of((p) => p.yRange),
      analysis: Object.fromEntries(Object.entries(scope.analyses).map(([name, chart]) => [name, { ...chart.settings }])),
    };
  }

  // returns the signals of the view that this axis lacks
  function apply(view) {
    const known = (name) => scope.fields.some((f) => f.name === name), missing = [...view.signals, view.trigger.signal].filter((name) => !known(name));
    [...scope.own.keys()].forEach(removeSignal);
    view.signals.forEach(addSignal);
    for (const [name] of ANALYSES) {
      analyse(name, name in view.analysis);
      if (scope.analyses[name]) scope.analyses[name].set(view.analysis[name]);
    }
    if ([...$("seconds").options].some((o) => Number(o.value) === view.seconds)) { scope.seconds = view.seconds; $("seconds").value = String(view.seconds); }
    for (const picture of everyPicture()) {
      const off = view.off[keyOf(picture)] || [];
      picture.spec.series.forEach((s, i) => { if (off.includes(s.label) !== picture.off.has(i)) picture.hide(i, off.includes(s.label)); });
      picture.setY(view.values[keyOf(picture)] || null);
    }
    setTrigger(missing.includes(view.trigger.signal) ? { ...view.trigger, kind: "none", signal: "reference_rps" } : view.trigger);
    return missing;
  }

  function listViews(name) {
    $("view").replaceChildren(new Option("–", ""), ...views.names.map((n) => new Option(n, n)));
    $("view").value = name || "";
  }

  function use(name, view) {
    const missing = apply(view);
    listViews(name);
    $("view-name").value = name;
    say(`View ${name}${missing.length ? `; this axis has no ${missing.join(", ")}` : ""}`, missing.length > 0);
  }

  async function importView(file) {
    try {
      const { name, view } = Views.read(await file.text());
      views.put(name, view);
      use(name, view);
    } catch (error) { say(`${file.name} was not imported: ${error.message}`, true); }
    $("view-import").value = "";
  }

  function draw(ms) {
    requestAnimationFrame(draw);
    if (!dirty || !scope.store || ms - drawnMs < Math.max(FRAME_MS - 8, 1.5 * costMs)) return;
    dirty = false;
    drawnMs = ms;
    const begun = performance.now();
    scope.pictures = (scope.pictures || 0) + 1;
    const [store, from, to] = looked();
    // faster changes cannot be read, and each change costs a page layout
    const still = Boolean(scope.view || scope.held), withNumbers = still || ms - numbersMs > NUMBERS_MS;
    for (const picture of pictures) picture.draw(store, from, to, scope.constant, withNumbers, !still);
    if (withNumbers) {
      numbersMs = ms;
      histogram.draw();
      numbers(store, from, to);
    }
    costMs = performance.now() - begun; // a slow machine draws less often and still answers to its buttons
  }

  function numbers(store, from, to) {
    const [begin, end] = store.between(from, to);
    const errors = store.column("error_rps", 2, begin, end, 1).filter((x) => x != null);
    const rms = Math.sqrt(errors.reduce((sum, x) => sum + x * x, 0) / Math.max(1, errors.length));
    const low = store.column("error_rps", 0, begin, end, 1), high = store.column("error_rps", 1, begin, end, 1);
    const peak = [...low, ...high].reduce((most, x) => Math.max(most, Math.abs(x || 0)), 0);
    const ticks = scope.late.reduce((sum, x) => sum + x[0], 0), late = scope.late.reduce((sum, x) => sum + x[1], 0);
    $("rms").textContent = errors.length ? rms.toPrecision(3) : "–";
    $("peak").textContent = errors.length ? peak.toPrecision(3) : "–";
    $("late").textContent = ticks ? `${(100 * late / ticks).toFixed(2)} %` : "–";
    $("span").textContent = `${(to - from).toPrecision(3)} s`;
  }

  // buttons and keys

  async function command(text, method, params) {
    const own = ++scope.asked; // an answer to what was asked for before comes too late for the line
    say(`${text} …`);
    const answer = await wire.call(method, params || {});
    if (own === scope.asked) say(answer.error ? `${text}: ${answer.error.replace(`${method}: `, "")}` : `${text}: done`, Boolean(answer.error));
  }

  // commands that give torque or motion name their epoch: they are refused after a stop not yet shown here
  function epoch() { return Number.isInteger(scope.epoch) ? { epoch: scope.epoch } : {}; }

  async function stop() {
    if ($("stop").disabled) { say("Stop is not available: this page is view only. Use the emergency stop of the machine.", true); return; }
    const own = ++scope.stops;
    scope.unconfirmed = false;
    say("Stop …");
    const answer = await wire.stop();
    if (own !== scope.stops) return;
    scope.asked += 1; // the answer to a stop takes the line, whatever was asked for since
    if (answer.error && AT_REST.includes(scope.state) && wire.open) say(`Stop: the axis is at rest already (${answer.error})`);
    else if (answer.error) { say(`STOP NOT CONFIRMED: ${answer.error}. Use the emergency stop of the machine.`, true); scope.unconfirmed = true; }
    else if (AT_REST.includes(answer.result.state)) say("Stop: the axis is at rest, no torque");
    else say(answer.result.method === "quick_stop" ? "Quick stop requested" : "Stop: braking to standstill, then no torque");
  }

  $("stop").onclick = stop;
  $("enable").onclick = () => command("Enable", "enable", { hold: $("tied").checked, ...epoch() });
  $("disable").onclick = () => command("Disable", "disable");
  $("start").onclick = () => command(`Start ${$("profile").value}`, "start", { profile: $("profile").value, ...epoch() });
  $("hold").onclick = () => command("Hold", "stop");
  $("reset").onclick = () => command("Reset fault", "reset_fault");
  for (const radio of document.querySelectorAll("input[name=toggle]")) radio.onchange = () => command(`Friction ${radio.value}`, "toggle", { to: radio.value });
  $("pause").onclick = () => (scope.view ? live() : pause());
  $("seconds").onchange = () => { scope.seconds = Number($("seconds").value); live(); };
  $("trigger").onchange = () => setTrigger({ kind: $("trigger").value });
  $("trigger-signal").onchange = () => setTrigger({ signal: $("trigger-signal").value });
  $("level").onchange = () => setTrigger({ level: Number($("level").value) || 0 });
  $("edge").onchange = () => setTrigger({ edge: $("edge").value });
  $("mode").onchange = () => setTrigger({ mode: $("mode").value });
  $("pre").onchange = () => setTrigger({ pre: Number($("pre").value) });
  $("save").onclick = save;
  $("signal").onchange = () => {
    const name = $("signal").value;
    if (name) addSignal(name); else [...scope.own.keys()].forEach(removeSignal);
    changed();
  };
  for (const [name, text, key] of ANALYSES) {
    element("button", $("analyses"), text, { id: `show-${name}`, type: "button", class: "analysis", "aria-pressed": "false", title: `key ${key}` }).onclick = () => { if (scope.store) { analyse(name, !scope.analyses[name]); changed(); } };
  }
  $("view").onchange = () => { const name = $("view").value; if (name) use(name, views.all[name]); };
  $("view-save").onclick = () => {
    const name = $("view-name").value.trim();
    if (!name) { say("A view needs a name: type it beside “named”", true); $("view-name").focus(); return; }
    views.put(name, settings());
    listViews(name);
    say(`View ${name} is saved in this browser`);
  };
  $("view-delete").onclick = () => { const name = $("view").value || $("view-name").value.trim(); if (views.names.includes(name)) { views.remove(name); listViews(); say(`View ${name} is deleted`); } else say("Choose the view to delete", true); };
  $("view-export").onclick = () => { const name = $("view-name").value.trim() || "view"; download([Views.file(name, settings())], "application/json", `${name}.scope.json`); };
  $("view-import").onchange = () => { const [file] = $("view-import").files; if (file) importView(file); };
  listViews();
  $("in").onclick = () => zoom(0.5, 0);
  $("out").onclick = () => zoom(2, 0);
  $("clear").onclick = () => { histogram.clear(); dirty = true; };

  const KEYS = { " ": () => $("pause").click(), Escape: stop, "+": () => zoom(0.5, 0), "=": () => zoom(0.5, 0), "-": () => zoom(2, 0), ArrowLeft: () => zoom(1, -0.25), ArrowRight: () => zoom(1, 0.25), "0": reset, c: save, s: () => $("show-spectrum").click(), t: () => $("show-step").click(), p: () => $("show-phase").click() };
  const SCROLLING = ["ArrowUp", "ArrowDown", "PageUp", "PageDown"]; // the page, unless a picture has the focus

  function toChart(e) {
    const chart = Chart.current || pictures[0];
    if (!chart || (SCROLLING.includes(e.key) && e.target !== chart.plotAt)) return false;
    return chart.key(e);
  }

  document.addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const typing = e.target.closest("select, input, summary") || (e.target.closest("button") && e.key === " ");
    if (!typing && e.key !== "Escape" && toChart(e)) { e.preventDefault(); return; }
    if (KEYS[e.key] && (e.key === "Escape" || !typing)) { e.preventDefault(); if (!e.repeat || e.key.startsWith("Arrow")) KEYS[e.key](); }
  });
  addEventListener("resize", () => everyPicture().forEach((p) => p.resize()));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { everyPicture().forEach((p) => p.build()); dirty = true; });
  requestAnimationFrame(draw);
})();
