// The page's two sockets: one for all messages (of a participant's screen: for what it shows), one in a worker for
// heartbeats and STOP, so that no other message delays these.

const RETRY_MS = 1000;

export class Link extends EventTarget {
  constructor(path = "live") {
    super();
    this.path = path;
    this.token = location.hash.slice(1) || sessionStorage.getItem("token") || "";
    sessionStorage.setItem("token", this.token); // a reload keeps it; the address shows it no longer
    history.replaceState(null, "", location.pathname);
    this.client = [...crypto.getRandomValues(new Uint8Array(12))].map((one) => one.toString(16).padStart(2, "0")).join("");
    this.number = 0;
    this.waiting = new Map();
    this.hold = new Worker("hold.js");
    this.hold.postMessage({ url: this.#url("hold"), protocols: this.#protocols() });
    // The worker sends a request and the page answers: a page that hangs sends no heartbeat, even if its worker runs.
    this.hold.addEventListener("message", ({ data }) => {
      if (data.alive) this.hold.postMessage({ alive: true });
      if (data.stopped) this.dispatchEvent(new CustomEvent("stopped"));
    });
    this.#open();
  }

  // Zero effort for every loop, ahead of all other messages of this page.
  stop() {
    this.hold.postMessage({ stop: true });
    if (this.socket?.readyState === WebSocket.OPEN) this.#send({ do: "stop" });
  }

  // Send a request. Rejects with the server's error: its message and the remedy.
  ask(what, content = {}) {
    const number = ++this.number;
    return new Promise((resolve, reject) => {
      if (this.socket?.readyState !== WebSocket.OPEN) {
        reject(new Error("The console is not connected. Is it still running?"));
        return;
      }
      this.waiting.set(number, { resolve, reject });
      this.#send({ do: what, number, ...content });
    });
  }

  // Send a message that needs no answer, if the socket is open.
  say(what, content = {}) {
    if (this.socket?.readyState === WebSocket.OPEN) this.#send({ do: what, ...content });
  }

  // A file of the server, as a blob.
  async fetch(path) {
    const response = await fetch(path, { headers: { Authorization: `Bearer ${this.token}` } });
    if (!response.ok) throw new Error(await response.text());
    return response.blob();
  }

  #send(message) {
    this.socket.send(JSON.stringify(message));
  }

  #url(name) {
    return `ws://${location.host}/${name}?client=${this.client}`;
  }

  // The token goes into the head of the request: the server reads no message before it.
  #protocols() {
    return ["rig", `token.${this.token.replace(/[^\w-]/g, "")}`];
  }

  #open() {
    this.socket = new WebSocket(this.#url(this.path), this.#protocols());
    this.socket.binaryType = "arraybuffer";
    this.socket.addEventListener("message", ({ data }) => this.#hear(data));
    this.socket.addEventListener("close", ({ reason }) => {
      for (const { reject } of this.waiting.values()) reject(new Error("The connection to the console was lost."));
      this.waiting.clear();
      this.dispatchEvent(new CustomEvent("closed", { detail: reason }));
      if (!reason.startsWith("the token")) setTimeout(() => this.#open(), RETRY_MS);
    });
  }

  #hear(data) {
    if (data instanceof ArrayBuffer) {
      this.dispatchEvent(new CustomEvent("frame", { detail: frameOf(data) }));
      return;
    }
    const message = JSON.parse(data);
    if (message.say !== "answer") {
      this.dispatchEvent(new CustomEvent(message.say, { detail: message }));
      return;
    }
    const waiting = this.waiting.get(message.to);
    this.waiting.delete(message.to);
    if (!waiting) return;
    if (message.error) {
      const error = new Error([message.error.error, message.error.remedy].filter(Boolean).join(": "));
      waiting.reject(Object.assign(error, { facts: message.error }));
    } else waiting.resolve(message.result);
  }
}

// Header, times, and for each column its least and greatest values (the same array where each point is one row).
export function frameOf(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const numbers = new Float64Array(buffer, 4 + length);
  const { points, columns, step } = header;
  const part = (place) => numbers.subarray(place * points, (place + 1) * points);
  const low = Object.fromEntries(columns.map((name, i) => [name, part(1 + i)]));
  const high = step === 1 ? low : Object.fromEntries(columns.map((name, i) => [name, part(1 + columns.length + i)]));
  return { ...header, times: part(0), low, high };
}
