// Explain: any second of a held-out flight, which rules spoke, and the models flown on an input that the mouse moves.
import { get } from "./api.js";
import { freeRun } from "./freerun.js";
import { colour, el, go, guarded, plain, swatch } from "./page.js";

const COLOURS = ["c1", "c0"];

// `worst`: by channel, the second that is shown first.
export async function explain(run, worst) {
  const box = el("details", { class: "explain" }, el("summary", {}, "Explain a second, move the input"));
  const body = el("div", {});
  box.append(body);
  box.addEventListener("toggle", guarded(async () => { if (box.open && !body.childElementCount) { await fill(body, run, worst); } }));
  return box;
}

async function fill(body, run, worst) {
  const names = [...new Set(run.channels.map((c) => c.channel.split("/")[0]))];
  const channel = el("select", { "aria-label": "Channel" }, names.map((name) => el("option", {}, name)));
  const segment = el("select", { "aria-label": "Held-out segment" });
  const view = el("div", {});
  body.append(el("div", { class: "tools" }, channel, segment), view);
  const load = guarded(async (k) => {
    const data = await get("runs/" + run.id + "/explanation", { ch: channel.value, segment: k });
    segment.replaceChildren(...data.segments.map(([flight, seconds], i) =>
      el("option", { value: String(i), selected: i === k }, flight + ", " + plain(+seconds.toPrecision(3)) + " s")));
    const here = worst[channel.value] && worst[channel.value].segment === k ? worst[channel.value].row : data.first;
    const shown = here < data.y.length ? Math.max(0, here - data.first) : 0; // of a long segment the beginning is shown
    show(view, run, channel.value, k, data, shown);
  });
  const first = () => (worst[channel.value] ? worst[channel.value].segment : 0);
  channel.addEventListener("change", () => load(first()));
  segment.addEventListener("change", () => load(+segment.value));
  await load(first());
}

function show(view, run, channel, segment, data, worst) {
  const { first, dt_s, models } = data, labels = Object.keys(models), n_y = data.outputs.length;
  const t = data.y.slice(first).map((_, k) => (first + k) * dt_s);
  const u = data.u.map((row) => row.slice());
  const flown = Object.fromEntries(labels.map((name) => [name, models[name].yh]));
  const words = el("div", { role: "status" }), charts = el("div", {});
  const wide = () => Math.max(240, view.clientWidth - 20);
  const axes = (label) => [
    { stroke: () => colour("dim"), grid: { stroke: () => colour("grid") }, size: 28 },
    { stroke: () => colour("dim"), grid: { stroke: () => colour("grid") }, size: 62, label, labelSize: 18, labelFont: "12px system-ui", values: (p, x) => x.map(plain) },
  ];
  const line = (name, dash) => ({ label: name, stroke: () => colour(COLOURS[labels.indexOf(name)] || "ink"), width: 1.4, dash, points: { show: false } });
  const column = (rows, j) => rows.map((row) => row[j]);
  view.replaceChildren();
  const [input, unit] = data.inputs[0], [output, unit_y] = data.outputs[0];
  const top = el("div", { class: "plot", tabindex: 0, role: "img", "aria-label": output + ": measured and models" });
  const low = el("div", { class: "plot", role: "img", "aria-label": input + ": as flown and as moved" });
  const at = el("input", { type: "number", step: "any", min: t[0], max: t[t.length - 1], "aria-label": "Second to explain", value: t[worst].toFixed(2) });
  const add = el("input", { type: "number", step: "any", value: "0", "aria-label": "Added to the input" });
  const from = el("input", { type: "number", step: "any", value: t[0].toFixed(2), "aria-label": "from, seconds" });
  const to = el("input", { type: "number", step: "any", value: t[t.length - 1].toFixed(2), "aria-label": "to, seconds" });
  const changed = el("span", { class: "hint" });
  view.append(
    el("p", { class: "hint" }, "Click the upper plot to explain that second. Draw with the mouse on the lower plot: the models fly your input."),
    el("div", { class: "tools" }, "Second ", at, el("button", { onclick: () => tell(+at.value) }, "Explain"),
      el("button", { onclick: () => { at.value = t[worst].toFixed(2); tell(t[worst]); } }, "The worst second"),
      el("button", { onclick: () => toFlight() }, "See it in the flight")),
    charts,
    el("div", { class: "tools" }, "Add ", add, " " + unit + " from ", from, " to ", to, " s",
      el("button", { onclick: () => {
        u.forEach((row, k) => { if (k * dt_s >= +from.value && k * dt_s <= +to.value) { row[0] += +add.value; } });
        refly();
      } }, "Fly it"),
      el("button", { onclick: () => { data.u.forEach((row, k) => { u[k] = row.slice(); }); refly(); } }, "As flown"), changed),
    words);
  charts.append(top, low);
  const upper = new uPlot({
    width: wide(), height: 240, legend: { show: false }, cursor: { sync: { key: "explain" }, drag: { x: false, y: false } }, scales: { x: { time: false } },
    axes: axes(output + (unit_y ? ", " + unit_y : "")),
    series: [{}, { label: "measured", stroke: () => colour("ink"), width: 1.6, points: { show: false } }, ...labels.map((name) => line(name)), ...labels.map((name) => line(name, [5, 4]))],
    hooks: { ready: [(plot) => plot.over.addEventListener("click", (event) => { const x = plot.posToVal(event.offsetX, "x"); at.value = x.toFixed(2); tell(x); })] },
  }, [t, column(data.y.slice(first), 0), ...labels.map((name) => column(models[name].yh, 0)), ...labels.map(() => t.map(() => null))], top);
  const lower = new uPlot({
    width: wide(), height: 150, legend: { show: false }, cursor: { sync: { key: "explain" }, drag: { x: false, y: false } }, scales: { x: { time: false } },
    axes: axes(input + (unit ? ", " + unit : "")),
    series: [{}, { label: "as flown", stroke: () => colour("dim"), width: 1.2, points: { show: false } }, { label: "moved", stroke: () => colour("c3"), width: 1.4, points: { show: false } }],
    hooks: { ready: [draw] },
  }, [t, column(data.u.slice(first), 0), column(u.slice(first), 0)], low);
  top.append(el("p", { class: "hint" }, "measured; ", labels.map((name, i) => [i ? ", " : "", swatch(COLOURS[i]), " " + name]).flat(), "; dashed: on the moved input"));
  top.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (way) { event.preventDefault(); at.value = Math.min(Math.max(+at.value + way * 10 * dt_s, t[0]), t[t.length - 1]).toFixed(2); tell(+at.value); }
  });

  function draw(plot) { // the mouse draws the input
    let last = null;
    const put = (event) => {
      const x = plot.posToVal(event.offsetX, "x"), y = plot.posToVal(event.offsetY, "y");
      const begin = last || [x, y], k0 = Math.round(Math.min(begin[0], x) / dt_s), k1 = Math.round(Math.max(begin[0], x) / dt_s);
      for (let k = Math.max(first, k0); k <= Math.min(k1, u.length - 1); k++) {
        const share = k1 === k0 ? 1 : (k * dt_s - begin[0]) / (x - begin[0]);
        u[k][0] = begin[1] + Math.min(Math.max(share, 0), 1) * (y - begin[1]);
      }
      last = [x, y];
      refly();
    };
    plot.over.addEventListener("pointerdown", (event) => { last = null; plot.over.setPointerCapture(event.pointerId); put(event); });
    plot.over.addEventListener("pointermove", (event) => { if (event.buttons & 1) { put(event); } });
  }

  function refly() {
    labels.forEach((name) => { if (models[name].recursion) { flown[name] = freeRun(models[name].recursion, u, n_y); } });
    const moved = labels.map((name) => (models[name].recursion ? column(flown[name], 0) : t.map(() => null)));
    upper.setData([t, column(data.y.slice(first), 0), ...labels.map((name) => column(models[name].yh, 0)), ...moved]);
    lower.setData([t, column(data.u.slice(first), 0), column(u.slice(first), 0)]);
    const fixed = labels.filter((name) => !models[name].recursion);
    changed.textContent = fixed.length ? " " + fixed.join(", ") + " cannot be flown in the page" : "";
    view.flown = flown;
  }

  const left = (missing) => (missing || []).map((sentence) => el("p", { class: "hint" }, sentence));

  async function tell(x) {
    const row = Math.min(Math.max(Math.round(x / dt_s), first), data.y.length - 1), k = row - first;
    const said = await get("runs/" + run.id + "/explanation", { ch: channel, segment, row });
    words.replaceChildren(...left(data.missing), ...left(said.missing), el("h2", {}, "At " + plain(row * dt_s) + " s: measured " + plain(+data.y[row][0].toPrecision(4)) + " " + unit_y));
    labels.forEach((name) => {
      const model = models[name];
      words.append(el("p", {}, swatch(COLOURS[labels.indexOf(name)]), " " + name + " in free run: ", el("b", {}, plain(+model.yh[k][0].toPrecision(4)) + " " + unit_y)));
      if (model.firing && model.firing[0].length > 1) {
        words.append(el("table", {}, el("tbody", {}, model.rules.map((label, r) => el("tr", {}, el("th", { scope: "row" }, label),
          el("td", {}, Math.round(100 * model.firing[k][r]) + " %"), el("td", {}, el("meter", { min: 0, max: 1, value: model.firing[k][r], "aria-label": label })),
          el("td", {}, "says " + plain(+model.said[k][r][0].toPrecision(4)) + " " + unit_y))))));
      }
      if (said.words[name]) { words.append(el("pre", { tabindex: 0 }, said.words[name])); }
    });
  }

  function toFlight() { // the chosen second, back in the log
    if (data.seen) { go("flights", secondOf(data.seen, +at.value)); } else { changed.textContent = " the flight is not in this studio"; }
  }
  tell(t[worst]);
}

// The address of a second of a flight, `x` seconds after what was seen of it begins: its signals, ten seconds, the cursor.
export function secondOf(seen, x) {
  const at = seen.begin_s + x;
  return { f: seen.flight, p: seen.signals.join(";"), t: [Math.max(0, at - 5), at + 5].join("~"), c: at + "~" };
}
