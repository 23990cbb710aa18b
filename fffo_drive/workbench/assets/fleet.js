"use strict";
// The fleet's store: how far its records are, its drives, and the page of its last report.
(() => {
  const bench = window.fffoWorkbench, $ = bench.$;
  const LOOK_MS = 5000; // a large store takes a moment to count
  const fleet = { state: null, askedMs: -Infinity, job: "", page: "", own: "" };
  window.fffoFleet = fleet;

  bench.onState((state) => {
    reports(state.pages.filter((page) => page.kind.startsWith("fleet")));
    const job = state.jobs[0], key = job ? `${job.number} ${job.state}` : ""; // at the end of a job it is looked at anew
    if ($("fleet").hidden || (key === fleet.job && performance.now() - fleet.askedMs < LOOK_MS)) return;
    Object.assign(fleet, { job: key, askedMs: performance.now() });
    bench.ask("fleet").then((found) => { fleet.state = found; show(found); bench.enable(); bench.advise(); }).catch(() => {}); // the page says when nobody answers
  });

  fleet.next = () => {
    const s = fleet.state;
    if (!s) return null;
    if (!s.store) return { act: "", text: "Next: name a store, with --fleet STORE or as daemon.fleet in the axis file" };
    if (!s.runs && !bench.state.runs.length) return { act: "", text: "Next: add runs, from the first tab or a folder: fffo-drive fleet add STORE --from FOLDER" };
    if (!s.runs) return { act: "fleet_add", text: "Next: tick runs on the first tab, and add them" };
    if (s.waiting) return { act: "fleet_work", text: "Next: make the records" };
    return $("fleet-pages").options.length ? null : { act: "fleet_report", text: "Next: report" };
  };

  function show(s) {
    const readable = s.store && !s.error;
    $("no-fleet").hidden = Boolean(s.store);
    $("fleet-store").textContent = s.store || "";
    $("fleet-error").hidden = !s.error;
    $("fleet-error").textContent = s.error || "";
    $("fleet-share").hidden = !readable;
    $("fleet-failures-fold").hidden = !readable || !s.failed;
    if (!readable) return;
    $("fleet-share").value = s.share;
    $("fleet-status").textContent = s.text.join("; ");
    $("fleet-failed").textContent = `${s.failed} failed`;
    bench.fill($("fleet-failures"), s.failures.map((one) => bench.element("li", one.reason)));
    if (s.own !== fleet.own) { fleet.own = s.own; $("fleet-serial").value = s.own; } // this axis' drive first
    const body = $("fleet-drives").tBodies[0], key = JSON.stringify(s.by_drive);
    $("fleet-more").textContent = s.drives > s.by_drive.length ? `and ${s.drives - s.by_drive.length} drives more: type the name of one` : "";
    if (body.dataset.key === key) return;
    body.dataset.key = key;
    bench.fill($("fleet-names"), s.by_drive.map((one) => new Option("", one.drive)));
    bench.fill(body, s.by_drive.map((one) => {
      const row = document.createElement("tr"), button = bench.element("button", one.drive);
      button.type = "button";
      button.setAttribute("aria-label", `history of ${one.drive}`);
      button.onclick = () => { $("fleet-serial").value = one.drive; };
      for (const content of [button, one.model, String(one.runs), one.first.slice(0, 10), one.last.slice(0, 10)]) row.insertCell().append(content);
      return row;
    }));
  }

  function reports(pages) {
    const last = $("fleet-pages").options.length ? $("fleet-pages").options[0].value : "";
    const isNew = pages.length && pages[0].page !== last; // the newest first: shown as it comes
    bench.options($("fleet-pages"), pages.map((page) => [page.page, `${page.name}: ${page.finding}`]), isNew ? pages[0].page : $("fleet-pages").value);
    open(pages);
  }

  function open(pages) {
    const page = pages.find((one) => one.page === $("fleet-pages").value), key = page ? page.page + page.time : "";
    if (!page || key === fleet.page) return;
    fleet.page = key;
    $("fleet-headline").textContent = page.headline;
    $("fleet-viewer").hidden = false;
    $("fleet-viewer").src = `files/${page.page}`;
  }

  $("fleet-pages").onchange = () => open(bench.state.pages);
})();
