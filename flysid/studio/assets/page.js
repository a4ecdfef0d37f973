// Small helpers that every page shares: elements, numbers for people, the address, errors.
import { Refused } from "./api.js";

export function el(tag, attributes, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {})) {
    if (value === undefined || value === null || value === false) { continue; }
    if (name.startsWith("on")) { made.addEventListener(name.slice(2), value); }
    else if (name in made && name !== "list" && typeof value !== "string") { made[name] = value; }
    else { made.setAttribute(name, value); }
  }
  for (const child of children.flat(Infinity)) {
    if (child !== null && child !== undefined && child !== false) { made.append(child); }
  }
  return made;
}

export function plain(value) {
  return value === null || value === undefined ? "\u2013" : String(+value.toPrecision(6)).replace("-", "\u2212");
}

export function clock(seconds) {
  const whole = Math.round(seconds), minutes = Math.floor(whole / 60) % 60, hours = Math.floor(whole / 3600);
  const two = (x) => String(x).padStart(2, "0");
  return (hours ? hours + ":" : "") + two(minutes) + ":" + two(whole % 60);
}

export function size(bytes) {
  return bytes < 1e6 ? Math.ceil(bytes / 1e3) + " kB" : (bytes / 1e6).toFixed(1) + " MB";
}

export function date(nanoseconds) {
  return nanoseconds ? new Date(Number(BigInt(nanoseconds) / 1000000n)).toISOString().slice(0, 16).replace("T", " ") : "";
}

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
}

export function swatch(name) { // a small square in one of the plots' colours
  const span = el("span", { class: "swatch" });
  span.style.background = "var(--" + name + ")";
  return span;
}

// The address holds the whole state: "#/flights?f=...&p=..." is what a reload or a link brings back.
export function address() {
  const [path, query] = location.hash.replace(/^#\/?/, "").split("?");
  return { page: path || "flights", query: new URLSearchParams(query || "") };
}

function write(page, query) {
  const words = new URLSearchParams();
  for (const [name, value] of Object.entries(query)) {
    for (const one of Array.isArray(value) ? value : [value]) {
      if (one !== undefined && one !== null && one !== "") { words.append(name, one); }
    }
  }
  history.replaceState(null, "", "#/" + page + (words.size ? "?" + words.toString() : ""));
}

export function go(page, query) {
  write(page, query);
  window.dispatchEvent(new HashChangeEvent("hashchange"));
}

// What a page has begun and must end with it. What it begins after it was left ends at once, and writes no address.
export class Stay {
  constructor() { Object.assign(this, { stops: [], isOver: false }); }

  push(stop) { if (this.isOver) { stop(); } else { this.stops.push(stop); } }

  keep(page, query) { if (!this.isOver) { write(page, query); } }

  end() {
    this.isOver = true;
    this.stops.forEach((stop) => stop());
  }
}

export function breakable(name) { // long names of streams may go on in the next line after an underscore
  return name.split(/(?<=_)/).map((part) => [part, el("wbr")]);
}

export function advice(error) { // what is wrong and what to do
  return error.message + (error.where ? " (" + error.where + ")" : "") + (error.hint ? ". Try: " + error.hint : "");
}

export function complain(error) {
  const box = document.getElementById("error");
  if (error && error.name === "AbortError") { return; }
  box.hidden = !error;
  box.textContent = "";
  if (!error) { return; }
  if (!(error instanceof Refused) && !(error instanceof TypeError)) { console.error(error); }
  const gone = error instanceof TypeError && /fetch/i.test(error.message);
  box.append(gone ? "The server does not answer. Start it again: flysid studio." : advice(error));
  box.append(" ", el("button", { onclick: () => complain(null) }, "Close"));
}

export function guarded(action) {
  return async (...given) => {
    try { return await action(...given); } catch (error) { complain(error); return undefined; }
  };
}

export function copyable(text) {
  const button = el("button", {
    onclick: guarded(async () => { await navigator.clipboard.writeText(text); button.textContent = "Copied"; }),
  }, "Copy");
  return el("div", {}, el("pre", { class: "command", tabindex: 0 }, text), button);
}
