"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const AT_REST = ["offline", "connected", "ready", "fault"];
  const MEANING = { offline: "no drive answers", connected: "no torque; may not be enabled", ready: "no torque; may be enabled", enabled: "torque, held at standstill", preparing: "torque, held at standstill; a start is being prepared", running: "a profile runs", following: "live set points are followed", stopping: "torque is on its way out", fault: "latched: reset, then enable again" };
  const FRAME_MS = 40, SILENT_MS = 1500, STALE_MS = 2500, TELL_MS = 200;
  const scope = { fields: [], store: null, shown: null, view: null, rate: 0, binTicks: 1, constant: null, state: "", seconds: 10, trigger: null, late: [], mayCommand: false };
  let pictures = [], histogram = null, capture = null, dirty = true, drawnMs = 0, costMs = 0, sign = 0, tripped = false, heardMs = 0, toldMs = 0;

  const token = location.hash.slice(1) || sessionStorage.getItem("scope-token") || "";
  if (location.hash) { // out of the address bar, for the next screenshot
    sessionStorage.setItem("scope-token", token);
    history.replaceState(null, "", location.pathname);
  }
  mayStop(Boolean(token));
  $("rights").hidden = Boolean(token);
  const wire = new Wire(token, hear, see, connection);
  window.fffoScope = scope; // for tests

  function say(text, bad) { $("said").textContent = text; $("said").className = bad ? "bad" : ""; }

  // what the page knows of its connection: none, open and not heard of yet, open and silent, with or without the key
  const link = { open: false, may: token ? null : false, heardMs: -Infinity };

  function connection(open) {
    Object.assign(link, { open, may: token ? null : false, heardMs: -Infinity });
    if (!open) mayCommand(false); // Stop stays as it is: it makes a connection
    tellLink();
  }

  function tellLink() {
    const silent = performance.now() - link.heardMs > STALE_MS;
    const text = !link.open ? "no connection to the daemon: what is shown is old"
      : link.heardMs < 0 ? "connected, waiting for the daemon"
      : silent ? `no status for ${((performance.now() - link.heardMs) / 1000).toFixed(0)} s: what is shown is old`
      : link.may === null ? "connected" : link.may ? "connected, with the key" : "connected, to look only";
    if ($("connection").textContent !== text) $("connection").textContent = text;
    document.body.classList.toggle("cut", !link.open || (link.heardMs > 0 && silent));
  }
  setInterval(tellLink, 500);

  function rights({ role, may }) { // a key that is not the daemon's (it was started anew) gives none
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
    $("rights").hidden = may || link.may === null; // not told yet, or not connected: nobody has refused anything
  }

  function mayStop(may) {
    $("stop").disabled = !may;
    $("may-stop").hidden = !may;
    $("may-look").hidden = may;
  }

  // what comes

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
      pictures = [...PICTURES.map((spec) => new Picture(spec, $("pictures"), select, live)), new FrictionMap($("pictures"))];
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
    if (facts.loop !== scope.loop) { scope.store.clear(); histogram.clear(); scope.late = []; sign = 0; tripped = false; }
    Object.assign(scope, { loop: facts.loop, rate: facts.rate_hz, binTicks: facts.bin_ticks, constant: facts.torque_constant_nm_per_a });
  }

  function status(s) {
    link.heardMs = performance.now();
    tellLink();
    if (scope.unconfirmed && AT_REST.includes(s.state)) {
      scope.unconfirmed = false;
      say(`Stop: the axis is at rest, no torque (confirmed late, by its state: ${s.state})`);
    }
    if (s.state === "fault" && scope.state !== "fault" && scope.state) armed("fault", scope.store.now);
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
    if (head.kind === "capture") { captured(head, buffer.slice(at)); return; }
    if (!scope.store || head.loop !== scope.loop) return;
    heardMs = performance.now();
    const values = new Float64Array(buffer, at), width = scope.fields.length * 3;
    scope.store.add(values, head.bins, scope.rate, scope.binTicks);
    for (let i = 0; i < head.bins; i++) watchTrigger(values.subarray(i * width, (i + 1) * width));
    histogram.add(head.lateness);
    scope.late.push([head.ticks, head.late]);
    if (scope.late.length > 250) scope.late.shift();
    dirty = true;
    if (scope.trigger && scope.store.now >= scope.trigger.until) fire();
  }

  // trigger: by the axis' own time, so that a busy browser takes the same rows

  function watchTrigger(bin) {
    const index = scope.store.index, reference = bin[index.reference_rps * 3 + 2], now = bin[index.tick * 3 + 2] / scope.rate;
    const newSign = Math.abs(reference) > 1e-6 ? Math.sign(reference) : sign;
    if (sign && newSign !== sign) armed("reversal", now);
    sign = newSign;
    const trip = bin[index.trip * 3 + 1] > 0;
    if (trip && !tripped) armed("fault", now);
    tripped = trip;
  }

  function armed(what, time) {
    if ($("trigger").value !== what || scope.trigger || scope.view) return;
    const seconds = Math.min(scope.seconds, scope.captureS || 10);
    scope.trigger = { what, time, seconds, until: time + seconds / 2 };
    say(`Trigger: ${what}; the rest of the window is being taken`);
  }

  // a loop that has ended sends no more: what there is, is taken
  setInterval(() => { if (scope.trigger && !scope.view && performance.now() - heardMs > SILENT_MS) fire(); }, 250);

  function fire() {
    const t = scope.trigger;
    if (!t || scope.view) { scope.trigger = null; return; }
    pause([t.time - t.seconds / 2, t.until]);
    say(`Triggered on ${t.what}: paused around it, at the full rate`);
    ask(t.seconds, Math.ceil(t.until * scope.rate), (buffer) => {
      scope.trigger = null;
      if (!scope.view || !buffer.byteLength) return;
      scope.triggered = buffer;
      scope.shown = storeOfRows(buffer, scope.fields, scope.rate);
      dirty = true;
    });
  }

  // capture at the full rate

  function ask(seconds, untilTick, done) {
    capture = { parts: [], rows: 0, done };
    wire.capture(seconds, untilTick);
  }

  function captured(head, payload) {
    if (!capture) return;
    capture.parts.push(payload);
    capture.rows += head.rows;
    if (capture.rows < head.total) return;
    const { parts, done } = capture;
    capture = null;
    new Blob(parts).arrayBuffer().then(done);
  }

  function save() {
    const seconds = Math.min(scope.seconds, scope.captureS || 10);
    const write = (buffer) => {
      const rows = Math.floor(buffer.byteLength / rowBytes(scope.fields));
      if (!rows) { say("No rows to save: the loop does not run", true); return; }
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob(csvParts(buffer, scope.fields), { type: "text/csv" }));
      link.download = `${$("axis").textContent}_${new Date().toISOString().replace(/[:.]/g, "-")}.csv`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60000);
      say(`Saved ${rows} rows at the full rate`);
    };
    if (scope.triggered) write(scope.triggered); else ask(seconds, null, write); // what the trigger has taken is what is looked at
  }

  // view

  function pause(view) {
    scope.shown = scope.shown || scope.store.snapshot();
    scope.view = view || [scope.store.now - scope.seconds, scope.store.now];
    $("pause").textContent = "Go on (space)";
    $("pause").setAttribute("aria-pressed", "true");
    document.body.classList.add("paused");
    dirty = true;
  }

  function live() {
    scope.view = scope.shown = scope.trigger = scope.triggered = null;
    $("pause").textContent = "Pause (space)";
    $("pause").setAttribute("aria-pressed", "false");
    document.body.classList.remove("paused");
    dirty = true;
  }

  function select(from, to) { if (to > from) pause([from, to]); }

  function zoom(factor, shift) {
    const [from, to] = scope.view || [scope.store.now - scope.seconds, scope.store.now];
    const middle = (from + to) / 2 + shift * (to - from), half = Math.min(60, Math.max(0.002, (to - from) / 2 * factor));
    pause([middle - half, middle + half]);
  }

  function draw(ms) {
    requestAnimationFrame(draw);
    if (!dirty || !scope.store || ms - drawnMs < Math.max(FRAME_MS - 8, 2 * costMs)) return;
    dirty = false;
    drawnMs = ms;
    const begun = performance.now();
    scope.pictures = (scope.pictures || 0) + 1;
    const store = scope.shown || scope.store, [from, to] = scope.view || [scope.store.now - scope.seconds, scope.store.now];
    // nobody reads numbers faster than this, and each of them lays the page out anew
    const tell = Boolean(scope.view) || ms - toldMs > TELL_MS;
    for (const picture of pictures) picture.draw(store, from, to, scope.constant, tell);
    if (tell) {
      toldMs = ms;
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
    say(`${text} …`);
    const answer = await wire.call(method, params || {});
    say(answer.error ? `${text}: ${answer.error}` : `${text}: done`, Boolean(answer.error));
  }

  // what gives torque or motion says in which epoch it was asked: a stop that this page has not shown yet refuses it
  function epoch() { return Number.isInteger(scope.epoch) ? { epoch: scope.epoch } : {}; }

  async function stop() {
    if ($("stop").disabled) { say("Stop is not available: this page only looks. Use the emergency stop of the machine.", true); return; }
    scope.unconfirmed = false;
    say("Stop …");
    const answer = await wire.stop();
    if (answer.error && AT_REST.includes(scope.state) && wire.open) say(`Stop: the axis is at rest already (${answer.error})`);
    else if (answer.error) { scope.unconfirmed = true; say(`STOP NOT CONFIRMED: ${answer.error}. Use the emergency stop of the machine.`, true); }
    else if (AT_REST.includes(answer.result.state)) say("Stop: the axis is at rest, no torque");
    else say(answer.result.method === "quick_stop" ? "Quick stop asked for" : "Stop: braking to standstill, then no torque");
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
  $("trigger").onchange = () => { scope.trigger = null; live(); say($("trigger").value === "none" ? "Trigger off" : `Trigger waits for a ${$("trigger").value}`); };
  $("save").onclick = save;
  $("signal").onchange = () => {
    const field = scope.fields.find((f) => f.name === $("signal").value);
    if (scope.own) { pictures = pictures.filter((p) => p !== scope.own); scope.own.remove(); scope.own = null; }
    if (field) {
      const series = [{ name: field.name, label: field.name, colour: "purple", width: 1.8, band: true }];
      scope.own = new Picture({ title: field.name, unit: field.unit || "-", series }, $("pictures"), select, live);
      pictures.push(scope.own);
    }
    dirty = true;
  };
  $("in").onclick = () => zoom(0.5, 0);
  $("out").onclick = () => zoom(2, 0);
  $("clear").onclick = () => { histogram.clear(); dirty = true; };

  const KEYS = { " ": () => $("pause").click(), Escape: stop, "+": () => zoom(0.5, 0), "=": () => zoom(0.5, 0), "-": () => zoom(2, 0), ArrowLeft: () => zoom(1, -0.25), ArrowRight: () => zoom(1, 0.25), "0": live, c: save };
  document.addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const typing = e.target.closest("select, input, summary") || (e.target.closest("button") && e.key === " ");
    if (KEYS[e.key] && (e.key === "Escape" || !typing)) { e.preventDefault(); if (!e.repeat || e.key.startsWith("Arrow")) KEYS[e.key](); }
  });
  addEventListener("resize", () => pictures.forEach((p) => p.resize()));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { pictures.forEach((p) => p.build()); dirty = true; });
  requestAnimationFrame(draw);
})();
