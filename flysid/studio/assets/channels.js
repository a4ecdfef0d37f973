// Channels: what the flights can identify, the aligned signals, what of them is fitted.
import { follow, get } from "./api.js";
import { advice, el, guarded, plain } from "./page.js";
import { FitPanel } from "./fit.js";
import { knownFields } from "./fields.js";
import { Parts, segments, stripOf } from "./strip.js";

const CLASS = { good: "good", weak: "weak" };
const MOST_COLUMNS = 16;
const LOOKED_AT = 6; // flights whose suggestions are asked for without a click
const MOST_STRIPS = 12;

export async function showChannels(main, query, stay) {
  const [{ flights, count }, { recipes }, { models }] = await Promise.all([get("flights", { most: 100 }), get("recipes"), get("models")]);
  const page = new Channels(main, query, flights, count, recipes, models, stay);
  await page.begin(query);
}

class Channels {
  constructor(main, query, flights, count, recipes, models, stay) {
    Object.assign(this, { flights, count, stay, open: null });
    this.ticked = new Set(); // "flight|recipe|channel"
    this.found = new Map(); // flight -> what was found
    this.aligned = new Map(); // what was asked -> the promise of an aligned channel
    this.parts = new Parts(query.getAll("x"), query.getAll("h"), () => this.partsChanged());
    this.fit = new FitPanel({
      recipes, models, query, parts: this.parts, stay,
      chosen: () => [...this.ticked].sort().map((id) => id.split("|")), // the same ticks, the same command, whichever flight was looked at first
      all: (ids) => ids.length === flights.length && count <= flights.length,
      picked: (recipe) => { this.untick(recipe); this.flights.forEach((flight) => this.preselect(flight.id)); this.draw(); },
      knows: (recipe) => [...this.found.values()].some((one) => one.suggestions.some((s) => s.recipe === recipe && s.verdict in CLASS)),
      changed: () => { this.aligned.clear(); this.stripped = ""; this.draw(); },
    });
    this.matrix = el("div", { class: "scroll", role: "region", "aria-label": "Flights and channels", tabindex: 0 });
    this.strips = el("section", { class: "strips", "aria-label": "Segments of the ticked flights" });
    this.cell = el("section", { class: "opened" });
    this.work = el("div", { class: "work" }, el("h1", {}, "What these flights can identify"),
      count ? el("p", { class: "hint" }, "A tick puts a channel of a flight into the fit. A cell shows its signals, and what of them is used.")
        : el("p", {}, "No flights yet. ", el("a", { href: "#/flights" }, "Drop a log"), " first."),
      this.matrix, this.strips, this.cell, this.fit.editor.box);
    main.append(this.work, this.fit.box);
  }

  async begin(query) {
    const described = this.flights.length ? get("flights/" + encodeURIComponent(this.flights[0].id)).then((flight) => this.work.append(...knownFields(flight))) : null;
    const looked = this.flights.slice(0, LOOKED_AT);
    await Promise.all([described, this.fit.resume(), ...looked.map((flight) => this.look(flight))]);
    looked.filter((flight) => this.found.get(flight.id)?.state === "done").forEach((flight) => this.preselect(flight.id));
    this.draw();
    this.fit.told();
    const [id, recipe, channel] = (query.get("sel") || "").split("|");
    const flight = this.flights.find((one) => one.id === id);
    const s = flight && this.suggestions(id).find((one) => one.recipe === recipe && one.channel === channel);
    if (s) { await this.show(flight, s); }
  }

  suggestions(flight) { return this.found.get(flight)?.suggestions || []; }

  async look(flight) {
    const path = "flights/" + encodeURIComponent(flight.id) + "/suggestions", answer = await get(path);
    this.found.set(flight.id, answer);
    this.draw();
    if (answer.state === "done" || !answer.job) { return; }
    this.stay.push(follow(answer.job, guarded(async (kind) => {
      if (kind !== "ended") { return; }
      this.found.set(flight.id, await get(path));
      this.preselect(flight.id);
      this.draw();
    })));
  }

  preselect(flight) { // the good channels of the recipe, or of the first recipe that has some
    if (this.fit.typed && !this.fit.recipe) { return; }
    const own = this.suggestions(flight), good = own.find((s) => s.verdict === "good");
    if (!this.fit.recipe && good) { this.fit.recipe = good.recipe; }
    own.filter((s) => s.recipe === this.fit.recipe && s.verdict === "good").forEach((s) => this.ticked.add([flight, s.recipe, s.channel].join("|")));
    this.fit.told();
  }

  untick(recipe) { // one recipe at a time: ticks of others go
    this.ticked.forEach((id) => { if (id.split("|")[1] !== recipe) { this.ticked.delete(id); } });
  }

  columns() { // recipe and channel of every suggestion: the chosen recipe first, then those that say most
    const goods = new Map();
    for (const s of [...this.found.values()].flatMap((one) => one.suggestions)) {
      const key = s.recipe + "|" + s.channel;
      goods.set(key, (goods.get(key) || 0) + (s.verdict === "good" ? 1 : 0));
    }
    const rank = (key) => (key.startsWith(this.fit.recipe + "|") ? 1000 : 0) + goods.get(key);
    return [...goods.keys()].sort((a, b) => rank(b) - rank(a)).slice(0, MOST_COLUMNS);
  }

  draw() {
    const keys = this.columns(), focused = document.activeElement?.dataset.cell;
    const head = el("tr", {}, el("th", { scope: "col" }, "flight"), keys.map((key) => {
      const [recipe, channel] = key.split("|");
      return el("th", { scope: "col" }, channel, el("br", {}), el("span", { class: "hint" }, recipe));
    }));
    this.matrix.replaceChildren(el("table", { class: "matrix" }, el("thead", {}, head), el("tbody", {}, this.flights.map((flight) => this.row(flight, keys)))));
    if (focused) { this.matrix.querySelector('[data-cell="' + CSS.escape(focused) + '"]')?.focus(); }
    this.drawStrips();
  }

  align(flight, recipe, channel) { // asked for once, as long as the same parts of the flight are left out
    const query = { f: flight, r: recipe, ch: channel, x: this.parts.of("out", flight) }, key = JSON.stringify(query);
    if (!this.aligned.has(key)) {
      this.aligned.set(key, get("align", query));
      this.aligned.get(key).catch(() => this.aligned.delete(key));
    }
    return this.aligned.get(key);
  }

  async drawStrips() { // of every ticked flight, by its first ticked channel
    const first = new Map([...this.ticked].reverse().map((id) => [id.split("|")[0], id])), ticked = this.flights.filter((one) => first.has(one.id));
    const wanted = ticked.slice(0, MOST_STRIPS), more = ticked.length - wanted.length;
    const state = JSON.stringify([wanted.map((one) => first.get(one.id)), this.parts.out, this.parts.held]);
    if (state === this.stripped) { return; }
    this.stripped = state;
    const rows = await Promise.all(wanted.map((one) => this.stripRow(one, first.get(one.id))));
    if (state !== this.stripped) { return; } // other ticks or parts since
    this.strips.replaceChildren(...rows.flat(), more ? el("p", { class: "hint" }, "and " + more + " more: open a cell") : "");
  }

  async stripRow(flight, id) {
    const [, recipe, channel] = id.split("|");
    try {
      const data = await this.align(flight.id, recipe, channel);
      return [el("p", { class: "hint" }, flight.log + ", " + channel + ": " + plain(+data.used_s.toPrecision(3)) + " s used"), stripOf(data, this.parts)];
    } catch (error) { return [el("p", { class: "hint" }, flight.log + ", " + channel + ": " + advice(error))]; }
  }

  row(flight, keys) {
    const own = this.found.get(flight.id), wide = (content) => el("td", { colSpan: Math.max(1, keys.length) }, content);
    const cells = !own ? wide(el("button", { onclick: guarded(() => this.look(flight)) }, "Look"))
      : own.state !== "done" ? wide(own.reason || "looking (" + own.state + ")")
      : own.suggestions.length ? keys.map((key) => this.entry(flight, key)) : wide("no recipe has its streams: fit from a field to a field");
    return el("tr", {}, el("th", { scope: "row" }, flight.log), cells);
  }

  entry(flight, key) {
    const [recipe, channel] = key.split("|"), id = flight.id + "|" + key;
    const s = this.suggestions(flight.id).find((one) => one.recipe === recipe && one.channel === channel);
    if (!s) { return el("td", { class: "bad" }, "\u2013"); }
    const tick = el("input", {
      type: "checkbox", checked: this.ticked.has(id), disabled: !(s.verdict in CLASS), "aria-label": "Fit " + channel + " of " + flight.log, "data-cell": "tick " + id,
      onchange: (event) => { this.tick(id, recipe, event.target.checked); },
    });
    const lines = [s.verdict + (s.coherence ? " " + s.coherence.toFixed(2) : "")];
    if (s.band_hz) { lines.push(s.band_hz.map((x) => plain(+x.toPrecision(2))).join(" to ") + " Hz"); }
    if (s.delay_s !== null && s.delay_s !== undefined) { lines.push(Math.round(1000 * s.delay_s) + " ms dead time"); }
    const advice = s.verdict in CLASS ? null : el("div", { class: "short" }, s.advice);
    const button = el("button", { onclick: () => this.show(flight, s), "data-cell": "open " + id, title: s.advice || "" }, lines.map((text) => el("div", {}, text)), advice);
    const isOpen = this.open && this.open.id === id;
    return el("td", { class: "cell " + (CLASS[s.verdict] || "bad"), "data-open": isOpen ? "yes" : null }, el("div", {}, tick, button));
  }

  tick(id, recipe, on) {
    if (on) { this.fit.recipe = recipe; this.untick(recipe); this.ticked.add(id); } else { this.ticked.delete(id); }
    this.fit.told();
    this.draw();
  }

  remember() {
    this.stay.keep("channels", { r: this.fit.recipe, sel: this.open && this.open.id, x: this.parts.out, h: this.parts.held, from: this.fit.fields.from.value, to: this.fit.fields.to.value });
  }

  partsChanged() {
    this.remember();
    this.fit.told();
    if (this.open) { this.show(this.open.flight, this.open.s); } else { this.drawStrips(); }
  }

  async show(flight, s) {
    this.open = { id: [flight.id, s.recipe, s.channel].join("|"), flight, s };
    this.remember();
    this.draw();
    const open = this.open, head = [el("h2", {}, s.channel + " of " + flight.log + ": " + s.verdict)];
    if (s.advice) { head.push(el("p", {}, s.advice)); }
    s.notes.forEach((note) => head.push(el("p", { class: "hint" }, note)));
    if (!this.cell.childElementCount) { this.cell.replaceChildren(el("p", { class: "hint", role: "status" }, "aligning")); }
    try {
      const data = await this.align(flight.id, s.recipe, s.channel);
      if (open !== this.open) { return; } // another was asked for since
      const lines = el("details", {}, el("summary", {}, "How it was aligned"), el("pre", { tabindex: 0 }, data.lines.join("\n")));
      this.cell.replaceChildren(...head, segments(data, this.parts, Math.max(240, this.work.clientWidth - 48)), lines);
    } catch (error) { this.cell.replaceChildren(...head, el("p", { role: "status" }, advice(error))); }
  }
}
