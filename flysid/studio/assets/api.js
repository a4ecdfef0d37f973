// Requests to the studio's own server, and its errors in flysid's words.

export class Refused extends Error {
  constructor(body, status) {
    super(body.message || "the server answered " + status);
    this.where = body.where || "";
    this.hint = body.hint || "";
    this.status = status;
  }
}

export function address(path, query) {
  const words = new URLSearchParams();
  for (const [name, value] of Object.entries(query || {})) {
    for (const one of Array.isArray(value) ? value : [value]) {
      if (one !== undefined && one !== null && one !== "") { words.append(name, one); }
    }
  }
  const text = words.toString();
  return "/api/1/" + path + (text ? "?" + text : "");
}

async function checked(answer) {
  if (answer.ok) { return answer; }
  let body = {};
  try { body = await answer.clone().json(); } catch { body = { message: await answer.text() }; }
  throw new Refused(body, answer.status);
}

export async function get(path, query, signal) {
  return (await checked(await fetch(address(path, query), { signal }))).json();
}

export async function send(method, path, body, query) {
  const raw = body instanceof Blob;
  const answer = await fetch(address(path, query), {
    method,
    headers: raw ? {} : { "content-type": "application/json" },
    body: body === undefined ? "" : raw ? body : JSON.stringify(body),
  });
  return (await checked(answer)).json();
}

// Curves in a window: {start_s, end_s, series: [{name, unit, whole, t: Float64Array, v: Array}]}.
export async function series(query, signal) {
  const answer = await checked(await fetch(address("series", query), { signal }));
  const bytes = await answer.arrayBuffer();
  const length = new DataView(bytes).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  let at = 4 + length;
  for (const one of head.series) {
    const times = new Float32Array(bytes, at, one.points);
    const values = new Float32Array(bytes, at + 4 * one.points, one.points);
    at += 8 * one.points;
    one.t = Float64Array.from(times, (x) => x + head.start_s);
    one.v = Array.from(values, (x) => (Number.isNaN(x) ? null : x + one.base));
    rise(one.t);
  }
  return head;
}

function rise(times) { // the table of a plot needs times that differ
  for (let i = 1; i < times.length; i++) {
    if (times[i] <= times[i - 1]) { times[i] = times[i - 1] + Math.max(1e-9, Math.abs(times[i - 1]) * 1e-15); }
  }
}

// Follows a job; `told` gets ("line", text), ("job", job) and at last ("ended", job). Returns a function that stops.
export function follow(job, told) {
  const source = new EventSource(address("jobs/" + job + "/events"));
  for (const kind of ["line", "job", "ended"]) {
    source.addEventListener(kind, (event) => {
      if (kind === "ended") { source.close(); }
      told(kind, JSON.parse(event.data));
    });
  }
  return () => source.close();
}
