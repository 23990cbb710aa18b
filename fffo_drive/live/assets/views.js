"use strict";
// Views by name in the browser's storage, and as small JSON files. A view holds the settings of the page, not its data.

const VIEW_FORMAT = "fffo-drive scope view", VIEW_VERSION = 1, VIEWS_KEY = "fffo-scope-views";
const KINDS = {
  seconds: (v) => Number.isFinite(v) && v > 0,
  signals: (v) => Array.isArray(v) && v.every((name) => typeof name === "string"),
  off: (v) => isTable(v) && Object.values(v).every((labels) => Array.isArray(labels)),
  values: (v) => isTable(v) && Object.values(v).every((range) => Array.isArray(range) && range.length === 2 && range.every(Number.isFinite) && range[0] < range[1]),
  trigger: (v) => isTable(v) && Number.isFinite(v.level) && Number.isFinite(v.pre),
  analysis: (v) => isTable(v) && Object.values(v).every(isTable),
};

function isTable(value) { return value !== null && typeof value === "object" && !Array.isArray(value); }

class Views {
  constructor(storage) { this.storage = storage; }

  // data left there by an older page or another program must not stop this page
  get all() {
    try {
      const found = JSON.parse(this.storage.getItem(VIEWS_KEY));
      return isTable(found) ? found : {};
    } catch { return {}; }
  }

  get names() { return Object.keys(this.all).sort(); }
  put(name, view) { this.storage.setItem(VIEWS_KEY, JSON.stringify({ ...this.all, [name]: view })); }
  remove(name) { const rest = this.all; delete rest[name]; this.storage.setItem(VIEWS_KEY, JSON.stringify(rest)); }

  static file(name, view) { return JSON.stringify({ format: VIEW_FORMAT, version: VIEW_VERSION, name, view }, null, 1) + "\n"; }

  // {name, view} of a file; an Error says what is wrong with it
  static read(text) {
    let content;
    try { content = JSON.parse(text); } catch { throw new Error("it is no JSON"); }
    if (!isTable(content) || content.format !== VIEW_FORMAT) throw new Error(`it is no saved view: \`format\` is not "${VIEW_FORMAT}"`);
    if (content.version !== VIEW_VERSION) throw new Error(`its version is ${content.version}, this page reads ${VIEW_VERSION}`);
    if (typeof content.name !== "string" || !content.name || !isTable(content.view)) throw new Error("it has no `name` or no `view`");
    for (const [key, fits] of Object.entries(KINDS)) if (!(key in content.view) || !fits(content.view[key])) throw new Error(`\`view.${key}\` is missing or has a wrong value`);
    return { name: content.name, view: content.view };
  }
}
