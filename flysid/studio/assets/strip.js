// A channel of a flight: its segments as a strip, its signals below. What is dragged over is left out of the fit; with Shift it is held out.
import { colour, el, plain } from "./page.js";
import { axes } from "./plots.js";

const LEAST_S = 0.5; // shorter is a click
const RIGHT = 16; // of a plot, so that the strip lies over it (studio.css)

function said(seconds) { // as the command takes it
  const tenths = Math.max(0, Math.round(10 * seconds));
  return Math.floor(tenths / 600) + ":" + ((tenths % 600) / 10).toFixed(1).padStart(4, "0");
}

function seconds(text) { return text.split(":").reduce((sum, part) => 60 * sum + Number(part), 0); }

// "FLIGHT@0:20.0..0:28.0" for seconds of the page's axis; boots: [[number, begin_s, end_s]]. Null where nothing is left of it.
function partOf(flight, boots, from, to) {
  const [number, begin, end] = boots.findLast((boot) => boot[1] <= from) || boots[0];
  const low = Math.max(from, begin), high = Math.min(to, end);
  if (high - low < LEAST_S) { return null; }
  return flight + (boots.length > 1 ? "#" + number : "") + "@" + said(low - begin) + ".." + said(high - begin);
}

function spanOf(part, flight, boots) { // the other way round: [from, to] on the page's axis, or null
  const found = /^([^#@]+)(?:#(\d+))?@(.*)\.\.(.*)$/.exec(part);
  const boot = found && found[1] === flight && boots.find((one) => one[0] === Number(found[2] || boots[0][0]));
  return boot ? [boot[1] + seconds(found[3] || "0"), found[4] ? boot[1] + seconds(found[4]) : boot[2]] : null;
}

// What is left out and what is held out, each a list of such parts.
export class Parts {
  constructor(out, held, changed) { Object.assign(this, { out, held, changed }); }

  add(kind, part) {
    if (!this[kind].includes(part)) { this[kind].push(part); this.changed(); }
  }

  remove(kind, part) {
    this[kind] = this[kind].filter((other) => other !== part);
    this.changed();
  }

  of(kind, flight) { return this[kind].filter((part) => part.split(/[#@]/)[0] === flight); }

  spans(kind, flight, boots) { return this[kind].map((part) => spanOf(part, flight, boots)).filter(Boolean); }

  list() { // as buttons that take a part back
    const one = (kind, what) => this[kind].map((part) => el("button", { class: "part " + kind, title: "Take it back",
      onclick: () => this.remove(kind, part) }, what + " ", part.replace(/-[0-9a-f]{8}(?=[#@]|$)/, ""), " \u00d7"));
    return [...one("out", "left out"), ...one("held", "held out")];
  }
}

function marking(data, parts) { // the seconds shown, what of them is marked, and what marks more
  const { flight, boots } = data;
  const range = [boots[0][1], Math.max(boots[boots.length - 1][2], boots[0][1] + 1e-3)];
  const mark = (kind, from, to) => { const part = partOf(flight, boots, Math.min(from, to), Math.max(from, to)); if (part) { parts.add(kind, part); } };
  return { range, mark, marked: { out: parts.spans("out", flight, boots), held: parts.spans("held", flight, boots) } };
}

// The strip of an aligned channel (`data`) by itself; `parts` is told what the mouse marks.
export function stripOf(data, parts) {
  const { range, marked, mark } = marking(data, parts);
  return strip(data, range, marked, mark);
}

// The strip and the plots of an aligned channel; `parts` is told what the mouse or the fields mark.
export function segments(data, parts, width) {
  const { range, marked, mark } = marking(data, parts);
  const box = el("section", { "aria-label": "Segments" }, legend(data), strip(data, range, marked, mark), fields(range, mark));
  data.signals.forEach((_, i) => signal(box, data, i, { range, marked, mark, width }));
  return box;
}

function legend(data) {
  const key = (kind, text) => [el("span", { class: "sample " + kind }), " " + text + " "];
  return el("p", { class: "hint" }, key("used", "used: " + plain(+data.used_s.toPrecision(3)) + " s in " + data.segments.length + " segments"),
    key("out", "left out: drag"), key("held", "held out: Shift-drag"), "over the strip or a plot.");
}

function strip(data, range, marked, mark) {
  const box = el("div", { class: "strip", role: "img", "aria-label": data.segments.length + " segments, " + plain(+data.used_s.toPrecision(3)) + " s used" });
  const share = (x) => 100 * (x - range[0]) / (range[1] - range[0]);
  const put = (kind, from, to) => {
    const span = el("span", { class: kind });
    span.style.left = share(from) + "%";
    span.style.width = share(to) - share(from) + "%";
    box.append(span);
    return span;
  };
  data.segments.forEach((one) => put("used", one.start_s, one.end_s));
  for (const kind of ["out", "held"]) { marked[kind].forEach(([from, to]) => put(kind, from, to)); }
  const at = (event) => range[0] + (range[1] - range[0]) * (event.clientX - box.getBoundingClientRect().left) / box.clientWidth;
  let from = null, shade = null;
  box.addEventListener("pointerdown", (event) => { from = at(event); shade = put(event.shiftKey ? "held" : "out", from, from); box.setPointerCapture(event.pointerId); });
  box.addEventListener("pointermove", (event) => {
    if (from === null) { return; }
    shade.style.left = share(Math.min(from, at(event))) + "%";
    shade.style.width = Math.abs(share(at(event)) - share(from)) + "%";
  });
  box.addEventListener("pointerup", (event) => {
    if (from === null) { return; }
    const begin = from;
    from = null;
    shade.remove();
    mark(event.shiftKey ? "held" : "out", begin, at(event));
  });
  return box;
}

function fields(range, mark) { // the same by keyboard
  const field = (label, value) => el("input", { type: "number", step: "any", "aria-label": label, value: value.toFixed(1) });
  const from = field("From, seconds", range[0]), to = field("To, seconds", range[1]);
  return el("div", { class: "tools" }, "From ", from, " to ", to, " s: ",
    el("button", { onclick: () => mark("out", +from.value, +to.value) }, "Leave out"),
    el("button", { onclick: () => mark("held", +from.value, +to.value) }, "Hold out"));
}

function signal(parent, data, i, { range, marked, mark, width }) {
  const [name, unit] = data.signals[i], title = name + (unit ? ", " + unit : "");
  const t = [], v = [];
  data.segments.forEach((one) => {
    one.time_s.forEach((x, k) => { t.push(x); v.push(one.values[i][k]); });
    if (one.time_s.length) { t.push(t[t.length - 1] + 1e-6); v.push(null); }
  });
  const chart = el("div", { role: "img", "aria-label": title + " over time" });
  parent.append(el("div", { class: "plot" }, el("div", { class: "head" }, el("b", {}, title)), chart));
  let own = null; // the drag that began here: the plots show one another's
  chart.addEventListener("mousedown", (event) => { own = event.shiftKey ? "held" : "out"; }, true);
  new uPlot({
    width, height: 140, padding: [8, RIGHT, 0, 0], legend: { show: false }, cursor: { sync: { key: "aligned" }, drag: { setScale: false } },
    scales: { x: { time: false, range } }, axes: axes(),
    series: [{}, { stroke: () => colour(i < data.signals.length - 1 ? "c1" : "c0"), width: 1.2, points: { show: false } }],
    hooks: {
      drawClear: [(plot) => shaded(plot, marked)],
      setSelect: [(plot) => {
        const { left, width: wide } = plot.select;
        if (wide > 0 && own) { mark(own, plot.posToVal(left, "x"), plot.posToVal(left + wide, "x")); }
        own = null;
      }],
    },
  }, [t, v], chart);
}

function shaded(plot, marked) {
  const { ctx: pen, bbox: box } = plot;
  for (const kind of ["out", "held"]) {
    pen.fillStyle = colour(kind === "out" ? "bad-bg" : "held-bg");
    marked[kind].forEach(([from, to]) => {
      const a = plot.valToPos(from, "x", true), b = plot.valToPos(to, "x", true);
      pen.fillRect(a, box.top, b - a, box.height);
    });
  }
}

