// Linked plots of fields over time: one window, one request for all of them, the newest answer drawn.
import { series } from "./api.js";
import { colour, complain, el, plain } from "./page.js";

const COLOURS = ["c0", "c1", "c2", "c3", "c4", "c5", "c6", "c7"];

export class Plots {
  // `changed` is called whenever what the address should hold has changed.
  constructor(parent, changed) {
    this.parent = parent;
    this.changed = changed;
    this.flight = null;
    this.panels = [];
    this.marks = [null, null];
    this.reading = el("p", { class: "reading", "aria-live": "polite" });
    this.list = el("div", {});
    this.empty = el("div", { class: "plot drop new" }, "Drag a field here, or choose it with Enter.");
    parent.append(this.reading, this.list, this.empty);
    this.accept(this.empty, (field) => this.add([field]));
    this.request = null;
    this.number = 0;
    this.drawn = 0;
    this.early = new Map(); // query -> answer on its way
    new ResizeObserver(() => this.resize()).observe(parent);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.panels.forEach((p) => p.plot && p.plot.redraw(false)));
  }

  expect(id, fields, view) { // the first curves, asked for before the flight is known
    this.queries(id, fields.flat(), view || [null, null]).forEach((query) => {
      const answer = series(query);
      answer.catch(() => {}); // it is looked at where it is used
      this.early.set(JSON.stringify(query), answer);
    });
  }

  queries(id, fields, [from, to]) { // sixteen fields at a time; null from and to: the whole flight
    const names = [...new Set(fields)], parts = [];
    const pixels = Math.min(4096, Math.max(200, Math.round((this.width() - 64) * Math.min(2, devicePixelRatio || 1))));
    for (let i = 0; i < names.length; i += 16) { parts.push({ f: id, s: names.slice(i, i + 16), t0: from, t1: to, w: pixels }); }
    return parts;
  }

  open(flight, fields, view, marks) {
    this.flight = flight;
    this.end = Math.max(flight.duration_s, 1e-3);
    this.view = view || [0, this.end];
    this.settle = !view; // the first answer shows how much of the flight these fields cover
    this.marks = marks || [null, null];
    this.panels.forEach((panel) => panel.plot && panel.plot.destroy());
    this.panels = [];
    this.list.textContent = "";
    fields.forEach((names) => this.panel(names));
    this.load();
  }

  get fields() { return this.panels.map((panel) => panel.names); }

  add(names, index) {
    if (index === undefined || !this.panels[index]) { this.panel(names); }
    else {
      const panel = this.panels[index];
      panel.names = [...new Set([...panel.names, ...names])].slice(0, COLOURS.length);
      this.build(panel);
    }
    this.load();
    this.changed();
  }

  remove(panel) {
    if (panel.plot) { panel.plot.destroy(); }
    const index = this.panels.indexOf(panel);
    this.panels.splice(index, 1);
    panel.box.remove();
    const next = this.panels[Math.min(index, this.panels.length - 1)];
    if (next) { next.chart.focus(); }
    this.changed();
  }

  panel(names) {
    const panel = { names: names.slice(0, COLOURS.length), data: [], plot: null };
    panel.box = el("section", { class: "plot" });
    panel.head = el("div", { class: "head" });
    panel.chart = el("div", { class: "chart", tabindex: 0, role: "img" });
    panel.box.append(panel.head, panel.chart);
    if (!this.panels.length) { this.lastWidth = this.width(); } // the observer tells of a first plot, too
    this.list.append(panel.box);
    this.panels.push(panel);
    this.accept(panel.box, (field) => this.add([field], this.panels.indexOf(panel)));
    panel.chart.addEventListener("keydown", (event) => this.key(event, panel));
    this.build(panel);
  }

  accept(box, take) { // a field that is dragged here
    box.addEventListener("dragover", (event) => {
      if (event.dataTransfer.types.includes("text/x-field")) { event.preventDefault(); box.classList.add("over"); }
    });
    box.addEventListener("dragleave", () => box.classList.remove("over"));
    box.addEventListener("drop", (event) => {
      const field = event.dataTransfer.getData("text/x-field");
      box.classList.remove("over");
      if (field) { event.preventDefault(); take(field); }
    });
  }

  build(panel) {
    panel.head.textContent = "";
    panel.values = panel.names.map((name, i) => {
      const line = el("span", { class: "line" });
      line.style.borderColor = "var(--" + COLOURS[i] + ")";
      const value = el("span", { class: "value" });
      const drop = () => {
        if (panel.names.length === 1) { this.remove(panel); return; }
        panel.names = panel.names.filter((other) => other !== name);
        this.build(panel);
        this.load();
        this.changed();
      };
      panel.head.append(el("button", { class: "key", title: "Remove " + name, onclick: drop }, line, shown(name), " ", value));
      return value;
    });
    panel.head.append(el("button", { class: "close", "aria-label": "Remove this plot", onclick: () => this.remove(panel) }, "\u00d7"));
    panel.chart.setAttribute("aria-label", panel.names.map(shown).join(", ") + " over time");
    if (panel.plot) { panel.plot.destroy(); }
    panel.plot = new uPlot({
      width: this.width(),
      height: 190,
      legend: { show: false },
      cursor: { sync: { key: "flight" }, drag: { x: true, y: false } },
      scales: { x: { time: false, range: (u, min, max) => [min, max] }, y: {} },
      axes: axes(),
      series: [{}].concat(panel.names.map((name, i) => ({
        label: name, stroke: () => colour(COLOURS[i]), width: 1.3, points: { show: false }, spanGaps: false,
      }))),
      hooks: {
        drawClear: [(plot) => this.behind(plot)],
        draw: [(plot) => this.over(plot)],
        setCursor: [(plot) => this.tell(plot)],
        setSelect: [(plot) => {
          const { left, width } = plot.select;
          if (width > 3) { this.look(plot.posToVal(left, "x"), plot.posToVal(left + width, "x")); }
          plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        }],
      },
    }, [[this.view[0], this.view[1]], ...panel.names.map(() => [null, null])], panel.chart);
    const plot = panel.plot;
    plot.over.addEventListener("dblclick", () => this.look(0, this.end));
    plot.over.addEventListener("click", (event) => {
      if (event.detail === 1 && Math.abs(plot.select.width) < 3) { this.mark(event.shiftKey ? 1 : 0, plot.posToVal(event.offsetX, "x")); }
    });
    plot.over.addEventListener("wheel", (event) => {
      event.preventDefault();
      const at = plot.posToVal(event.offsetX, "x"), factor = event.deltaY < 0 ? 0.75 : 1 / 0.75;
      this.look(at - (at - this.view[0]) * factor, at + (this.view[1] - at) * factor);
    }, { passive: false });
  }

  key(event, panel) {
    if (event.ctrlKey || event.metaKey || event.altKey) { return; }
    const span = this.view[1] - this.view[0];
    const moves = { ArrowLeft: [-0.2, -0.2], ArrowRight: [0.2, 0.2], "+": [0.25, -0.25], "=": [0.25, -0.25], "-": [-0.5, 0.5] };
    const move = moves[event.key];
    const step = { ",": [0, -1], ".": [0, 1], "<": [1, -1], ">": [1, 1] }[event.key];
    if (move) { this.look(this.view[0] + move[0] * span, this.view[1] + move[1] * span); }
    else if (step) {
      const [which, way] = step;
      const from = this.marks[which] === null ? (this.view[0] + this.view[1]) / 2 : this.marks[which] + way * span / 100;
      this.mark(which, from);
    } else if (event.key === "0") { this.look(0, this.end); }
    else if (event.key === "x") { this.remove(panel); }
    else if (event.key === "Escape") { this.marks = [null, null]; this.retell(); }
    else { return; }
    event.preventDefault();
  }

  look(from, to) {
    const span = Math.min(Math.max(to - from, 1e-4), this.end);
    const start = Math.min(Math.max(from, 0), this.end - span);
    this.view = [+start.toPrecision(9), +(start + span).toPrecision(9)]; // as the address keeps it
    this.panels.forEach((panel) => panel.plot.setScale("x", { min: this.view[0], max: this.view[1] })); // at once, with the old points
    this.load();
    this.changed();
  }

  mark(which, at) {
    this.marks[which] = Math.min(Math.max(at, 0), this.end);
    this.retell();
    this.changed();
  }

  retell() {
    this.panels.forEach((panel) => panel.plot.redraw(false));
    this.tell(null);
  }

  width() { return Math.max(240, this.list.clientWidth - 16); }

  resize() {
    if (!this.panels.length || this.width() === this.lastWidth) { return; }
    this.lastWidth = this.width();
    this.panels.forEach((panel) => panel.plot.setSize({ width: this.width(), height: 190 }));
    this.load();
  }

  async load() {
    if (this.request) { this.request.abort(); }
    if (!this.flight || !this.panels.length) { return; }
    this.request = new AbortController();
    const { signal } = this.request, number = ++this.number, view = this.view;
    const isWhole = view[0] === 0 && view[1] === this.end, early = this.early, loaded = new Map();
    this.early = new Map();
    try {
      for (const query of this.queries(this.flight.id, this.panels.flatMap((panel) => panel.names), isWhole ? [null, null] : view)) {
        (await (early.get(JSON.stringify(query)) || series(query, signal))).series.forEach((one) => loaded.set(one.name, one));
      }
    } catch (error) { complain(error); return; }
    if (number !== this.number) { return; } // a newer window has been asked for
    if (this.settle) {
      this.settle = false;
      const times = [...loaded.values()].filter((one) => one.t.length).map((one) => [one.t[0], one.t[one.t.length - 1]]);
      const from = Math.min(...times.map((pair) => pair[0])), to = Math.max(...times.map((pair) => pair[1]));
      if (times.length && to > from && to - from < 0.7 * this.end) { this.look(from, to); return; }
    }
    this.panels.forEach((panel) => {
      panel.data = panel.names.map((name) => loaded.get(name)).filter(Boolean);
      if (panel.data.length !== panel.names.length) { return; }
      panel.plot.batch(() => {
        panel.plot.setData(uPlot.join(panel.data.map((one) => (one.t.length ? [one.t, one.v] : [[view[0]], [null]]))), false);
        panel.plot.setScale("x", { min: view[0], max: view[1] });
        panel.plot.setScale("y", extent(panel.data));
      });
    });
    this.drawn = number;
    this.list.dataset.drawn = view.join("~");
    this.tell(null);
  }

  behind(plot) { // flight modes as bands, messages and parameter changes as ticks
    if (!this.flight) { return; }
    const pen = plot.ctx, box = plot.bbox, ratio = devicePixelRatio || 1;
    pen.save();
    pen.beginPath();
    pen.rect(box.left, box.top, box.width, box.height);
    pen.clip();
    pen.textAlign = "left";
    pen.textBaseline = "alphabetic";
    pen.font = 11 * ratio + "px system-ui";
    this.flight.modes.forEach(([start, end, name], i) => {
      const a = plot.valToPos(start, "x", true), b = plot.valToPos(end, "x", true);
      if (i % 2 === 0) { pen.fillStyle = colour("grid"); pen.fillRect(a, box.top, b - a, box.height); }
      if (this.panels[0] && plot === this.panels[0].plot && b - Math.max(a, box.left) > pen.measureText(name).width + 8 * ratio) {
        pen.fillStyle = colour("dim");
        pen.fillText(name, Math.max(a, box.left) + 4 * ratio, box.top + 13 * ratio);
      }
    });
    this.flight.moments.forEach(([at, kind]) => {
      pen.fillStyle = colour(kind === "parameter" ? "c1" : "c3");
      pen.fillRect(Math.round(plot.valToPos(at, "x", true)), box.top, ratio, 7 * ratio);
    });
    pen.restore();
  }

  over(plot) { // the two cursors
    const pen = plot.ctx, box = plot.bbox, ratio = devicePixelRatio || 1;
    this.marks.forEach((at, i) => {
      if (at === null || at < this.view[0] || at > this.view[1]) { return; }
      pen.fillStyle = colour(i ? "c4" : "ink");
      pen.fillRect(Math.round(plot.valToPos(at, "x", true)), box.top, ratio, box.height);
    });
  }

  tell(plot) { // values under the mouse, else at the first cursor; differences between the two cursors
    const left = plot ? plot.cursor.left : -1;
    const [a, b] = this.marks;
    const at = left !== null && left >= 0 ? plot.posToVal(left, "x") : a;
    this.reading.textContent = "";
    const say = (label, text) => this.reading.append(el("span", {}, label, el("b", {}, text)));
    if (at !== null) {
      say("", plain(at) + " s");
      this.flight.modes.filter(([start, end]) => start <= at && at < end).forEach(([, , name]) => say("mode ", name));
      const reach = (this.view[1] - this.view[0]) / 150;
      this.flight.moments.filter(([when]) => Math.abs(when - at) < reach).slice(0, 3).forEach(([, , text]) => say("", text));
    }
    if (a !== null && b !== null) { say("between cursors ", plain(b - a) + " s (" + plain(1 / Math.abs(b - a || Infinity)) + " Hz)"); }
    this.panels.forEach((panel) => panel.data.forEach((one, i) => {
      const value = at === null ? null : latest(one, at);
      const difference = a !== null && b !== null && left < 0 ? " \u0394 " + plain(step(one, a, b)) : "";
      panel.values[i].textContent = at === null ? "" : plain(value) + (one.unit ? " " + one.unit : "") + difference;
    }));
    if (this.told) { this.told(at); }
  }
}

export function axes() { // time below, values on the left
  const axis = {
    stroke: () => colour("dim"), grid: { stroke: () => colour("grid"), width: 1 }, ticks: { show: false },
    font: "12px system-ui", values: (u, values) => values.map(plain),
  };
  return [{ ...axis, size: 30 }, { ...axis, size: 64 }];
}

export function shown(name) {
  const [stream, field] = [name.slice(0, name.lastIndexOf(":")), name.slice(name.lastIndexOf(":") + 1)];
  return stream.startsWith("@") ? field : stream + "." + field;
}

function latest(one, at) { // the newest sample that is not after `at`
  let low = 0, high = one.t.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (one.t[middle] <= at) { low = middle + 1; } else { high = middle; }
  }
  return low ? one.v[low - 1] : null;
}

function step(one, a, b) {
  const first = latest(one, a), second = latest(one, b);
  return first === null || second === null ? null : second - first;
}

function extent(data) {
  let low = Infinity, high = -Infinity;
  data.forEach((one) => one.v.forEach((x) => {
    if (x !== null && x < low) { low = x; }
    if (x !== null && x > high) { high = x; }
  }));
  if (low > high) { return { min: 0, max: 1 }; }
  const margin = 0.06 * (high - low) || 0.06 * Math.abs(high) || 1;
  return { min: low - margin, max: high + margin };
}
