"use strict";
// The connection, and the page's commands. A stop needs the key and waits for nothing else: without a
// connection it opens one.

const RECONNECT_MS = 1000, STOP_ANSWER_MS = 3000, HERE_MS = 250;

class Wire {
  constructor(token, onText, onBinary, onConnection) {
    this.token = token;
    this.onText = onText;
    this.onBinary = onBinary;
    this.onConnection = onConnection;
    this.number = 0;
    this.waiting = new Map();
    this.unsent = [];
    this.hereMs = -Infinity;
    this.connect();
  }

  connect() {
    clearTimeout(this.timer);
    const socket = this.socket = new WebSocket(`ws://${location.host}/live${this.token ? `?key=${encodeURIComponent(this.token)}` : ""}`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      if (this.token) socket.send(JSON.stringify({ do: "token", token: this.token }));
      for (const message of this.unsent.splice(0)) socket.send(message);
      this.onConnection(true);
    };
    socket.onmessage = (event) => {
      if (typeof event.data !== "string") { this.onBinary(event.data); return; }
      const message = JSON.parse(event.data);
      if (message.kind === "answer" && this.waiting.has(message.id)) {
        this.waiting.get(message.id)(message);
        this.waiting.delete(message.id);
      } else this.onText(message);
    };
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.waiting.forEach((done) => done({ error: "the connection to the daemon broke" }));
      this.waiting.clear();
      this.onConnection(false);
      this.timer = setTimeout(() => this.connect(), RECONNECT_MS);
    };
  }

  get open() { return this.socket.readyState === WebSocket.OPEN; }

  ask(message) {
    const id = ++this.number;
    return new Promise((resolve) => {
      this.waiting.set(id, resolve);
      this.socket.send(JSON.stringify({ ...message, id }));
    });
  }

  call(method, params) {
    return this.open ? this.ask({ do: "call", method, params }) : Promise.resolve({ error: "no connection to the daemon" });
  }

  // a sign of life, sent on what comes: a hidden page's timers may sleep. A page that holds the axis has to be heard
  here() {
    if (!this.open || performance.now() - this.hereMs < HERE_MS) return;
    this.hereMs = performance.now();
    this.socket.send('{"do": "here"}');
  }

  // resolves with {error} when it is not confirmed in time: the operator must then act by other means
  stop() {
    const late = new Promise((resolve) => setTimeout(() => resolve({ error: "the stop was not confirmed within 3 s" }), STOP_ANSWER_MS));
    if (this.open) return Promise.race([this.ask({ do: "stop" }), late]);
    const id = ++this.number;
    const answer = new Promise((resolve) => this.waiting.set(id, resolve));
    this.unsent = [JSON.stringify({ do: "stop", id })];
    if (this.socket.readyState !== WebSocket.CONNECTING) this.connect();
    late.then(() => { this.unsent = []; }); // never sent minutes later
    return Promise.race([answer, late]);
  }

  // returns whether it was sent
  capture(id, seconds, untilTick, signals) {
    if (this.open) this.socket.send(JSON.stringify({ do: "capture", id, seconds, until_tick: untilTick, signals }));
    return this.open;
  }
}
