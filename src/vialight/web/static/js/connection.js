// Talking to the server: requests, and sockets that come back by themselves.

const ARRAYS = { u1: Uint8Array, i1: Int8Array, u2: Uint16Array, i2: Int16Array, u4: Uint32Array, i4: Int32Array,
  f4: Float32Array };

// A binary message, as vialight/web/encoding.py packs it.
export function decode(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const arrays = {};
  for (const [name, item] of Object.entries(header.arrays)) {
    const count = item.shape.reduce((product, size) => product * size, 1);
    arrays[name] = { ...item, values: new ARRAYS[item.dtype](buffer, 4 + length + item.offset, count) };
  }
  return { header, arrays };
}

export class Refused extends Error {
  constructor(status, message) {
    super(message);
    this.status = status;
  }
}

async function ask(path, options = {}) {
  const response = await fetch(path, { credentials: "same-origin", ...options });
  if (response.ok) return response;
  let why = `${response.status}`;
  try {
    why = (await response.json()).error ?? why;
  } catch { /* not JSON: the number must do */ }
  throw new Refused(response.status, why);
}

export const getJson = async (path) => (await ask(path)).json();
export const getBinary = async (path) => decode(await (await ask(path)).arrayBuffer());

export async function post(path, body, timeoutMs = 5000) {
  // Stop's own listener is on another port: for a browser another origin, to which the cookie goes only when told.
  const isElsewhere = path.startsWith("http:");
  const options = { method: "POST", signal: AbortSignal.timeout(timeoutMs),
    credentials: isElsewhere ? "include" : "same-origin" };
  if (body !== undefined) {
    options.body = JSON.stringify(body);
    options.headers = { "Content-Type": "application/json" };
  }
  const response = await ask(path, options);
  return response.status === 204 ? null : response.json();
}

// A socket of one channel.  Every message is answered once it has been taken, and only then the next of its kind comes.
export class Channel {
  constructor(path, take, onChange) {
    Object.assign(this, { path, take, onChange, isOpen: false, why: "", waitMs: 250, isOver: false });
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(`ws://${location.host}${this.path}`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => {
      this.isOpen = true;
      this.waitMs = 250;
      this.onChange(this);
    };
    this.socket.onmessage = (event) => this.receive(event.data);
    this.socket.onclose = (event) => {
      this.isOpen = false;
      this.why = event.reason;
      this.onChange(this);
      if (this.isOver) return;
      this.timer = setTimeout(() => this.connect(), this.waitMs);
      this.waitMs = Math.min(this.waitMs * 1.5, 2000);
    };
  }

  receive(data) {
    const message = typeof data === "string" ? { header: JSON.parse(data), arrays: {} } : decode(data);
    const { kind } = message.header;
    // Seen by the browser's own tools, and by the benchmark.
    performance.mark(kind, { detail: { frames: message.header.frames, time_s: message.header.time_s } });
    if (performance.getEntriesByName(kind).length > 500) performance.clearMarks(kind);
    try {
      this.take(message);
    } finally {
      if (kind !== "answer") this.send({ got: kind });
    }
  }

  send(message) {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  close() {
    this.isOver = true;
    clearTimeout(this.timer);
    this.socket.close();
  }
}
