"use strict";
// The axis as its daemon tells it, and what is asked of it. Nothing is asked for whose state is not known: a request for
// torque or motion names the epoch of the status on the page, and a status that is old allows none.
(() => {
  const bench = window.fffoWorkbench, $ = bench.$;
  const AT_REST = ["offline", "connected", "ready", "fault"], TORQUE = ["enabled", "following"];
  const STALE_MS = 2500, STOP_ANSWER_MS = 3000, HERE_MS = 180, RENEWED_SHARE = 0.25, SHOWN_EVENTS = 30;
  const axis = { source: null, page: "", info: null, status: null, heardMs: -Infinity, hereMs: 0, unconfirmed: false, stopping: false, speaker: 0, stops: 0, turning: null, trial: 0, gains: "" };
  window.fffoAxis = axis; // for tests

  const fresh = () => axis.status !== null && performance.now() - axis.heardMs < STALE_MS;
  const may = (method) => bench.state !== null && bench.state.asks.includes(method);
  const epoch = () => ({ epoch: axis.status.epoch });
  const send = (method, wish) => bench.ask(`axis/${method}`, wish || {});
  // a stop that nothing has confirmed stays said until the state confirms it
  function say(text, bad) { if (!axis.unconfirmed) { $("axis-said").textContent = text; $("axis-said").className = bad ? "bad" : ""; } }
  // what is asked for last has the line: an answer to what was asked for before comes too late for it, but that to a stop
  function speaker() { const own = ++axis.speaker; return { say: (text, bad) => { if (own === axis.speaker) say(text, bad); } }; }

  // what comes

  bench.onState((state) => {
    const daemon = state.daemon, service = state.services.serve, drive = state.services.simulate;
    $("no-daemon").hidden = Boolean(daemon);
    $("with-daemon").hidden = !daemon;
    $("halt").hidden = !daemon;
    const served = service && service.state === "running";
    $("serve").hidden = Boolean(daemon) || served;
    $("unserve").hidden = !served;
    $("unserve").disabled = !state.may_cancel;
    const simulates = drive && drive.state === "running";
    // with a daemon, only where it is known that no drive answers: one may have been started elsewhere
    const silent = !daemon || (axis.status !== null && axis.status.state === "offline");
    $("simulated").hidden = !state.axis || !state.axis.simulated || !(simulates || silent);
    $("simulate").hidden = simulates;
    $("simulate").disabled = !state.may.includes("simulate");
    $("stop-simulation").hidden = !simulates;
    $("stop-simulation").disabled = !state.may_cancel;
    $("simulated-state").textContent = drive ? `fffo-drive sim: ${drive.state}${drive.exit_code ? `, exit code ${drive.exit_code}` : ""}. ${drive.output.at(-1) || "It starts."}` : "";
    $("service-fold").hidden = !service;
    if (service) {
      $("service-state").textContent = `fffo-drive serve: ${service.state}${service.exit_code ? `, exit code ${service.exit_code}` : ""}`;
      $("service-output").textContent = [service.line, ...service.output].join("\n");
    }
    $("scope-link").hidden = !daemon || !daemon.scope;
    if (daemon && daemon.scope) $("scope-link").href = daemon.scope;
    if (daemon && !axis.source) connect();
    if (!daemon && axis.source) leave("the daemon of this axis has ended");
    trials(state.trials);
    allow();
  });

  function connect() {
    axis.source = new EventSource("axis/live");
    axis.source.onmessage = (event) => hear(JSON.parse(event.data));
    axis.source.onerror = () => { axis.status = null; allow(); if (axis.source.readyState === EventSource.CLOSED) leave(""); };
  }

  function leave(why) {
    axis.source.close();
    Object.assign(axis, { source: null, status: null, page: "" });
    release();
    if (why) say(why, true);
    allow();
  }

  function hear(message) {
    if (message.kind === "hello") axis.page = message.page;
    if (message.kind === "hello" || performance.now() - axis.hereMs > HERE_MS) { // on what comes, not by a timer: a hidden page's timers may sleep for minutes
      axis.hereMs = performance.now();
      if (axis.page) send("here", { page: axis.page }).catch(() => {});
    }
    if (message.kind === "hello") {
      $("axis-events").replaceChildren();
      message.events.forEach(event);
      info(message.info);
    } else if (message.kind === "status") status(message.status);
    else if (message.kind === "event") event(message.event);
    else if (message.kind === "info") info(message.info);
  }

  function status(s) {
    axis.status = s;
    axis.heardMs = performance.now();
    if (AT_REST.includes(s.state) && (axis.unconfirmed || axis.stopping)) {
      const late = axis.unconfirmed ? ` (confirmed late, by its state: ${s.state})` : "";
      axis.unconfirmed = axis.stopping = false;
      say(`Stop: the axis is at rest, no torque${late}`);
    }
    document.body.dataset.axis = s.state;
    const running = s.profile ? `: ${s.profile.name}, ${Math.max(0, 100 * s.profile.sample / Math.max(1, s.profile.samples)).toFixed(0)} %` : s.set_point ? `: ${s.set_point.kind} to ${s.set_point.to_rps.toPrecision(3)} rps` : "";
    $("axis-state").textContent = s.state.toUpperCase();
    $("axis-stop").textContent = s.last_stop ? `${s.last_stop.text} at ${s.last_stop.at.slice(11, 19)} UTC` : "";
    $("axis-doing").textContent = s.state === "enabled" && !acts(s) ? ": no torque yet" : running;
    $("axis-fault").hidden = !s.fault;
    if (s.fault) $("axis-fault").textContent = `Fault: ${s.fault.text} (${s.fault.name}). Remove the cause, then reset it.`;
    $("axis-obstacles").textContent = s.obstacles.length ? `Not ready: ${s.obstacles.join("; ")}` : "";
    const m = s.motion, recording = s.recording.on ? `${s.recording.rows_written} rows${s.recording.trouble ? `: ${s.recording.trouble}` : ""}` : "off";
    const rows = [["drive", s.drive ? `${s.drive.name || "drive"}: ${s.drive.state}` : "none answers"], ["velocity", m ? `${m.velocity_rps.toFixed(3)} rps of ${m.reference_rps.toFixed(3)}` : "–"],
      ["position", m ? `${m.position_rev.toFixed(4)} rev` : "–"], ["current", m ? `${m.current_a.toFixed(3)} A` : "–"], ["model", s.model.name], ["late ticks", s.loop ? `${s.loop.late} of ${s.loop.tick}` : "–"], ["recording", recording], ...(s.recording.disk_life ? [["disk", s.recording.disk_life.text]] : []), ["held by", s.held_by || "nobody"]];
    bench.fill($("axis-live"), rows.flatMap(([name, text]) => [bench.element("dt", name), bench.element("dd", text)]));
    for (const radio of document.querySelectorAll("input[name=friction]")) radio.checked = radio.value === s.toggle;
    allow();
  }

  function info(found) {
    axis.info = found;
    bench.options($("start-profile"), found.profiles.map((name) => [name, name]), $("start-profile").value || found.profiles[0]);
    if (axis.gains === JSON.stringify(found.keys)) return;
    axis.gains = JSON.stringify(found.keys);
    bench.fill($("gains").tBodies[0], Object.entries(found.keys).map(([key, value]) => gain(key, value)));
    allow();
  }

  function event(e) {
    if (e.kind === "parameters" || e.kind === "reload") bench.ask("axis/info").then(info).catch(() => {});
    const item = bench.element("li", `${e.time.slice(11, 19)} ${e.level === "info" ? "" : e.level.toUpperCase() + " "}${e.text}`);
    item.className = e.level;
    $("axis-events").prepend(item);
    while ($("axis-events").children.length > SHOWN_EVENTS) $("axis-events").lastChild.remove();
  }

  // the law acts: in state enabled the drive may still be switching on, or its brake be opening, and refuses motion
  const acts = (s) => Boolean(s.motion) && s.motion.mode !== "idle";

  // what may be asked for in this state; a stop always
  function allow() {
    const s = fresh() ? axis.status.state : "";
    const moves = TORQUE.includes(s) && acts(axis.status);
    const able = { enable: s === "ready", disable: s !== "" && !AT_REST.includes(s), start: s === "enabled" && moves, end: ["preparing", "running", "following"].includes(s), "jog-back": moves, "jog-ahead": moves, go: moves, step: moves, reset: s === "fault" };
    const method = { end: "stop", "jog-back": "jog", "jog-ahead": "jog", go: "velocity", reset: "reset_fault" };
    for (const [id, on] of Object.entries(able)) $(id).disabled = !on || !may(method[id] || id);
    if (!moves) release(s === "" ? ": no status of it comes" : ""); // a button that is greyed holds nothing
    $("serve").disabled = !bench.state || !bench.state.may_serve || !bench.state.axis || !bench.state.axis.on_bus;
    $("no-bus").hidden = !bench.state || !bench.state.axis || bench.state.axis.on_bus !== false;
    $("halt").disabled = !may("disable");
    $("quick").disabled = !may("quick_stop");
    for (const radio of document.querySelectorAll("input[name=friction]")) radio.disabled = s === "" || !may("toggle");
    for (const button of document.querySelectorAll("#gains button")) button.disabled = s === "" || !may("set") || (button.dataset.trial && (!moves || !bench.state.may_try));
    const silent = axis.source && axis.status && !fresh();
    $("axis-link").textContent = !axis.source ? "" : axis.status === null ? "no connection to the daemon: the data shown are old" : silent ? "no status for some seconds: the data shown are old" : "";
    document.body.classList.toggle("cut", Boolean(axis.source) && !fresh());
  }
  setInterval(allow, 500);

  // what is asked for

  const said = (error, method) => error.message.replace(`${method}: `, ""); // the line names it already
  async function command(text, method, wish) {
    const line = speaker();
    line.say(`${text} …`);
    try {
      const { result } = await send(method, wish);
      line.say(`${text}: ${result.reached === false ? "asked for" : "done"}`);
    } catch (error) { line.say(`${text}: ${said(error, method)}`, true); }
  }

  async function halt(method) {
    const name = method === "quick_stop" ? "Quick stop" : "Stop", own = ++axis.stops;
    axis.unconfirmed = false;
    release();
    speaker().say(`${name} …`);
    try {
      const { result } = await Promise.race([send(method, { wait_s: 0 }), new Promise((_, late) => setTimeout(() => late(new Error("nothing confirmed the stop in 3 s")), STOP_ANSWER_MS))]);
      if (own !== axis.stops) return;
      axis.stopping = !AT_REST.includes(result.state);
      speaker().say(!axis.stopping ? `${name}: the axis is at rest, no torque` : method === "quick_stop" ? "Quick stop asked for" : "Stop: braking to standstill, then no torque");
    } catch (error) {
      if (own !== axis.stops) return;
      speaker().say(`STOP NOT CONFIRMED: ${error.message}. Use the emergency stop of the machine.`, true);
      axis.unconfirmed = true;
    }
  }

  function stop() {
    if ($("halt").hidden || $("halt").disabled) { speaker().say("Stop is not available: no daemon has this axis, or this page only looks. Use the emergency stop of the machine.", true); return; }
    halt(axis.status && axis.status.state === "stopping" ? "quick_stop" : "disable"); // asked for again while it stops
  }

  const asked = (what, ask) => bench.confirmed(what).then((yes) => { if (yes && fresh()) ask(); else if (yes) say("the state of the axis is not known: nothing was asked for", true); });
  $("halt").onclick = stop;
  $("quick").onclick = () => halt("quick_stop");
  $("enable").onclick = () => asked("get torque and be held at standstill", () => command("Enable", "enable", { ...($("tied").checked ? { page: axis.page } : {}), wait_s: 0, ...epoch() }));
  $("disable").onclick = () => command("Disable", "disable", { wait_s: 0 });
  $("end").onclick = () => command("End the motion", "stop", { wait_s: 0 });
  $("reset").onclick = () => command("Reset the fault", "reset_fault", { wait_s: 0 });
  $("start").onclick = () => asked(`run the profile ${$("start-profile").value}`, () => command(`Start ${$("start-profile").value}`, "start", { profile: $("start-profile").value, ...epoch() }));
  $("go").onclick = () => {
    const to_rps = number("velocity");
    if (to_rps !== 0 && !$("run-on").checked) { turn("Velocity", "velocity", to_rps); return; }
    release();
    command(`Velocity ${to_rps} rps`, "velocity", { to_rps, run_on: true, ...epoch() });
  };
  $("step").onclick = () => command(`Step by ${number("step-by")} rps`, "step", { by_rps: number("step-by"), for_s: number("step-for"), ...epoch() });
  const service = (what, wish) => bench.ask(what, wish).then(() => say(""), (error) => say(error.message, true)).then(bench.look);
  $("serve").onclick = () => service("serve", {});
  $("unserve").onclick = () => service("cancel", { service: "serve" });
  $("simulate").onclick = () => service("simulate", {});
  $("stop-simulation").onclick = () => service("cancel", { service: "simulate" });
  for (const radio of document.querySelectorAll("input[name=friction]")) radio.onchange = () => command(`Friction ${radio.value}`, "toggle", { to: radio.value });
  function number(id) { return Number($(id).value); }

  document.addEventListener("keydown", (e) => {
    if (e.key !== "Escape" || $("halt").hidden) return;
    if (!$("ask").open) e.preventDefault(); // it closes the question as well
    if (!e.repeat) stop();
  });

  // a set point lives on a lease: the page renews a jog as long as a button or a key is held, a velocity as long as the
  // page is shown; let go, hidden or gone it ends at standstill, and without a word of the page the daemon brakes by
  // itself. What renews it names the epoch that was shown when it was asked for: no renewal undoes a stop

  function release(why) { if (axis.turning && axis.turning.held) axis.turning.release(typeof why === "string" ? why : ""); }
  function letGo() { if (axis.turning && axis.turning.method === "jog") release(); }

  async function turn(name, method, to_rps) {
    const before = axis.turning;
    if (before && before.held && before.method === method) { if (method === "velocity") before.to_rps = to_rps; return; } // one hand
    release();
    const own = axis.turning = { held: true, name, method, to_rps, ...epoch() };
    const released = new Promise((done) => { own.release = (why) => { Object.assign(own, { held: false, why }); done(); }; });
    own.over = (before ? before.over : Promise.resolve()).then(() => renew(own, released)); // pressed again while it brakes
    await own.over;
    if (axis.turning === own) axis.turning = null;
  }

  async function renew(own, released) {
    let last = null;
    if (!own.held) return;
    const line = speaker();
    line.say(`${own.name} ${own.to_rps} rps …`);
    try {
      if (!fresh()) throw new Error("the state of the axis is not known: nothing was asked for");
      while (own.held) {
        last = (await send(own.method, { to_rps: own.to_rps, epoch: own.epoch, ...(last && last.renew_within_s ? { renews: last.set_point } : {}) })).result; // a jog at 0 needs no renewal
        await Promise.race([released, new Promise((done) => setTimeout(done, 1000 * RENEWED_SHARE * (last.renew_within_s || 1)))]);
      }
      await send("jog", { to_rps: 0, epoch: own.epoch, ...(last.renew_within_s ? { renews: last.set_point } : {}) });
      line.say(`${own.name} ended at standstill${own.why}`, Boolean(own.why));
    } catch (error) { line.say(`${own.name}: ${said(error, own.method)}`, true); }
    own.release("");
  }

  const jog = (direction) => turn("Jog", "jog", direction * Math.abs(number("jog-rps")));
  for (const [id, direction] of [["jog-back", -1], ["jog-ahead", 1]]) {
    const button = $(id);
    button.onpointerdown = (e) => { if (e.button === 0) { button.setPointerCapture(e.pointerId); jog(direction); } };
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture", "blur", "contextmenu"]) button.addEventListener(kind, letGo);
    button.onkeydown = (e) => { if ((e.key === " " || e.key === "Enter") && !e.repeat) { e.preventDefault(); jog(direction); } };
    button.onkeyup = (e) => { if (e.key === " " || e.key === "Enter") { e.preventDefault(); letGo(); } };
  }
  addEventListener("blur", letGo);
  addEventListener("pagehide", release);
  document.addEventListener("visibilitychange", () => { if (document.hidden) release(); });

  // gains

  function gain(key, value) {
    const row = document.createElement("tr"), input = document.createElement("input"), isSwitch = typeof value === "boolean";
    input.type = isSwitch ? "checkbox" : "number";
    input.step = "any";
    if (isSwitch) input.checked = value; else input.value = value;
    input.setAttribute("aria-label", `new value of ${key}`);
    const read = () => (isSwitch ? input.checked : Number(input.value));
    const apply = bench.element("button", "Apply"), trial = bench.element("button", "Step before and after");
    for (const button of [apply, trial]) { button.type = "button"; button.setAttribute("aria-label", `${button.textContent}: ${key}`); }
    trial.dataset.trial = "1";
    apply.onclick = () => command(`${key} = ${read()}`, "set", { key, value: read() });
    trial.onclick = () => asked(`step by ${number("trial-by")} rps for ${number("trial-for")} s, twice`, async () => {
      try { axis.trial = (await send("try_gain", { key, value: read(), by_rps: number("trial-by"), for_s: number("trial-for"), ...epoch() })).number; say(`${key}: a step with the gains in use`); } catch (error) { say(error.message, true); }
      bench.look();
    });
    const name = bench.element("code", key.replace(/^controller\./, ""));
    for (const content of [name, String(value), input]) row.insertCell().append(content);
    row.insertCell().append(apply, " ", trial);
    return row;
  }

  // both responses in one picture, once a trial has ended
  function trials(all) {
    const last = all.at(-1), key = last ? `${last.number} ${last.state}` : "";
    $("trial-says").textContent = last ? `${last.key}: ${last.old_value ?? "…"} → ${last.value}, step by ${last.by_rps} rps for ${last.for_s} s: ${last.says}` : "";
    $("trial-says").className = last && last.state === "failed" ? "bad" : "";
    if (last && last.state !== "running" && last.number === axis.trial) { axis.trial = 0; say(""); }
    if (!last || last.state === "running" || $("trial").dataset.key === key) return;
    $("trial").dataset.key = key;
    bench.ask(`axis/trial/${last.number}`).then(draw).catch((error) => say(error.message, true));
  }

  function draw(trial) {
    $("trial").replaceChildren();
    if (!trial.time_s) return;
    const { before, after } = trial.velocity_rps;
    linePlot($("trial"), `Step response, ${trial.key}`, "rps", trial.time_s, [
      { label: "reference", colour: "ink", dash: [7, 5], width: 1.2, values: trial.reference_rps },
      { label: `before, ${trial.old_value}`, colour: "orange", dash: [9, 4], values: before },
      ...(after ? [{ label: `after, ${trial.value}`, colour: "blue", width: 2, values: after }] : []),
    ]);
    const table = document.createElement("table"), head = table.createTHead().insertRow(), body = table.createTBody();
    for (const text of ["", "error rms, rps", "largest error, rps", "overshoot, %"]) { const cell = bench.element("th", text); cell.scope = "col"; head.append(cell); }
    for (const [name, response] of Object.entries(trial.figures)) {
      const row = body.insertRow();
      for (const text of [name, response.rms_rps.toPrecision(3), response.peak_rps.toPrecision(3), response.overshoot_percent.toFixed(1)]) row.insertCell().append(text);
    }
    $("trial").append(table);
    if (after && trial.old_value !== null && trial.old_value !== trial.value) {
      const back = bench.element("button", `Take it back: ${trial.old_value}`);
      back.type = "button";
      back.disabled = !may("set");
      back.onclick = () => command(`${trial.key} = ${trial.old_value}`, "set", { key: trial.key, value: trial.old_value });
      $("trial").append(back);
    }
    $("trial").scrollIntoView({ block: "nearest" });
  }
})();
