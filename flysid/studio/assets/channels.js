// Channels: what the flights can identify, the aligned signals, and the fit.
import { follow, get, send } from "./api.js";
import { colour, copyable, el, go, guarded, keep, plain } from "./page.js";
import { watch } from "./jobs.js";
import { shown } from "./plots.js";

const CLASS = { good: "good", weak: "weak" };
const MODELS = ["line", "static_ts", "ts", "ts_ss", "statespace", "tf", "fir", "armax"];
const MOST_COLUMNS = 16;
const LOOKED_AT = 6; // flights whose suggestions are asked for without a click

function said(seconds) { // as --between takes it
  const tenths = Math.max(0, Math.round(10 * seconds));
  return Math.floor(tenths / 600) + ":" + ((tenths % 600) / 10).toFixed(1).padStart(4, "0");
}

export async function showChannels(main, query) {
  const stops = [];
  const work = el("div", { class: "work" }), right = el("aside", { class: "right", "aria-label": "Fit" });
  main.append(work, right);
  const [{ flights, count }, { recipes }] = await Promise.all([get("flights", { most: 100 }), get("recipes")]);
  const chosen = new Map(); // "flight|recipe|channel" -> true
  const found = new Map(); // flight -> suggestions
  const stretches = new Map(); // flight -> [start_s, end_s] to fit alone
  let recipe = query.get("r") || "";
  let between = "";

  work.append(el("h1", {}, "What these flights can identify"));
  if (!count) { work.append(el("p", {}, "No flights yet. ", el("a", { href: "#/flights" }, "Drop a log"), " first.")); }
  const matrix = el("div", { class: "scroll" }), cell = el("section", { "aria-live": "polite" });
  work.append(el("p", { class: "hint" }, "A tick puts a channel of a flight into the fit; its name shows the signals."), matrix, cell);

  const look = guarded(async (flight) => {
    const answer = await get("flights/" + encodeURIComponent(flight.id) + "/suggestions");
    if (answer.state === "done" || !answer.job) { found.set(flight.id, answer); draw(); return; }
    found.set(flight.id, { state: answer.state, suggestions: [] });
    draw();
    stops.push(follow(answer.job, guarded(async (kind) => {
      if (kind !== "ended") { return; }
      found.set(flight.id, await get("flights/" + encodeURIComponent(flight.id) + "/suggestions"));
      preselect(flight.id);
      draw();
    })));
  });

  function columns() { // recipe and channel of every suggestion, the recipes that say most first
    const goods = new Map();
    for (const { suggestions } of found.values()) {
      for (const s of suggestions) {
        const key = s.recipe + "|" + s.channel;
        goods.set(key, (goods.get(key) || 0) + (s.verdict === "good" ? 1 : 0));
      }
    }
    const rank = (key) => (key.startsWith(recipe + "|") ? 1000 : 0) + goods.get(key); // the chosen recipe first
    return [...goods.keys()].sort((a, b) => rank(b) - rank(a)).slice(0, MOST_COLUMNS);
  }

  function preselect(flight) {
    if (typed && !recipe) { return; }
    if (!recipe) {
      const good = found.get(flight).suggestions.find((s) => s.verdict === "good");
      if (good) { recipe = good.recipe; fields.recipe.value = recipe; }
    }
    found.get(flight).suggestions.filter((s) => s.recipe === recipe && s.verdict === "good")
      .forEach((s) => chosen.set(flight + "|" + s.recipe + "|" + s.channel, true));
    command();
  }

  function draw() {
    const keys = columns();
    const focused = document.activeElement && document.activeElement.dataset.cell;
    const head = el("tr", {}, el("th", { scope: "col" }, "flight"), keys.map((key) => {
      const [name, channel] = key.split("|");
      return el("th", { scope: "col" }, channel, el("br", {}), el("span", { class: "hint" }, name));
    }));
    const rows = flights.map((flight) => {
      const own = found.get(flight.id);
      const cells = !own ? [el("td", { colSpan: Math.max(1, keys.length) }, el("button", { onclick: () => look(flight) }, "Look"))]
        : own.state !== "done" ? [el("td", { colSpan: Math.max(1, keys.length) }, own.reason ? own.reason : "looking (" + own.state + ")")]
        : keys.map((key) => entry(flight, key, own.suggestions));
      return el("tr", {}, el("th", { scope: "row" }, flight.log), cells);
    });
    matrix.replaceChildren(el("table", {}, el("thead", {}, head), el("tbody", {}, rows)));
    if (focused) { const again = matrix.querySelector('[data-cell="' + CSS.escape(focused) + '"]'); if (again) { again.focus(); } }
  }

  function entry(flight, key, suggestions) {
    const [name, channel] = key.split("|");
    const s = suggestions.find((one) => one.recipe === name && one.channel === channel);
    if (!s) { return el("td", { class: "bad" }, "\u2013"); }
    const id = flight.id + "|" + key;
    const usable = s.verdict === "good" || s.verdict === "weak";
    const tick = el("input", {
      type: "checkbox", checked: chosen.has(id), disabled: !usable, "aria-label": "Fit " + channel + " of " + flight.log, "data-cell": "tick " + id,
      onchange: (event) => {
        if (event.target.checked) { pick(name); chosen.set(id, true); } else { chosen.delete(id); }
        command();
        draw();
      },
    });
    const told = [s.verdict + (s.coherence ? " " + s.coherence.toFixed(2) : "")];
    if (s.band_hz) { told.push(s.band_hz.map((x) => plain(+x.toPrecision(2))).join(" to ") + " Hz"); }
    if (s.delay_s !== null && s.delay_s !== undefined) { told.push("dead time " + Math.round(1000 * s.delay_s) + " ms"); }
    const button = el("button", { onclick: () => open(flight, s), "data-cell": "open " + id }, told.map((text) => el("div", {}, text)));
    return el("td", { class: "cell " + (CLASS[s.verdict] || "bad") }, tick, button);
  }

  function pick(name) { // one recipe at a time: ticks of another go
    if (name === recipe) { return; }
    recipe = name;
    fields.recipe.value = name;
    [...chosen.keys()].filter((id) => id.split("|")[1] !== name).forEach((id) => chosen.delete(id));
  }

  const open = guarded(async (flight, s) => {
    cell.replaceChildren(el("p", { class: "hint" }, "aligning"));
    keep("channels", { r: recipe, sel: flight.id + "|" + s.recipe + "|" + s.channel });
    const head = [el("h2", {}, s.channel + ", " + flight.log + ": " + s.verdict)];
    if (s.advice) { head.push(el("p", {}, s.advice)); }
    s.notes.forEach((note) => head.push(el("p", { class: "hint" }, note)));
    let data;
    try { data = await get("align", { f: flight.id, r: s.recipe, ch: s.channel }); }
    catch (error) { cell.replaceChildren(...head, el("p", {}, error.message + (error.hint ? ". Try: " + error.hint : ""))); return; }
    const strip = segmentStrip(flight, data);
    const charts = el("div", {});
    cell.replaceChildren(...head, strip, charts, el("pre", { tabindex: 0 }, data.lines.join("\n")));
    data.signals.forEach(([name, unit], i) => signalPlot(charts, data, i, name + (unit ? ", " + unit : "")));
  });

  function segmentStrip(flight, data) {
    const box = el("div", { class: "strip" });
    const total = Math.max(flight.duration_s, 1e-3);
    const place = (span, a, b) => { span.style.left = (100 * a) / total + "%"; span.style.width = (100 * (b - a)) / total + "%"; };
    data.segments.forEach((segment) => { const span = el("span", {}); place(span, segment.start_s, segment.end_s); box.append(span); });
    const mine = el("span", { class: "mine", hidden: true });
    box.append(mine);
    const from = el("input", { type: "number", min: 0, step: "any", "aria-label": "Fit from, seconds" });
    const to = el("input", { type: "number", min: 0, step: "any", "aria-label": "Fit to, seconds" });
    const show = () => {
      const stretch = stretches.get(flight.id);
      mine.hidden = !stretch;
      if (stretch) { place(mine, ...stretch); from.value = stretch[0].toFixed(1); to.value = stretch[1].toFixed(1); } else { from.value = to.value = ""; }
      between = stretch ? stretch.map((x) => said(x - data.beginning_s)).join("..") : "";
      command();
    };
    const set = (a, b) => {
      if (b - a > 0.5) { stretches.clear(); stretches.set(flight.id, [Math.max(0, a), Math.min(total, b)]); } else { stretches.delete(flight.id); }
      show();
    };
    let start = null;
    const at = (event) => ((event.clientX - box.getBoundingClientRect().left) / box.clientWidth) * total;
    box.addEventListener("pointerdown", (event) => { start = at(event); box.setPointerCapture(event.pointerId); });
    box.addEventListener("pointerup", (event) => { if (start !== null) { const end = at(event); set(Math.min(start, end), Math.max(start, end)); start = null; } });
    const typed = () => set(+from.value || 0, +to.value || 0);
    from.addEventListener("change", typed);
    to.addEventListener("change", typed);
    show();
    return el("div", {}, el("p", { class: "hint" }, "Green: used, " + plain(+data.used_s.toPrecision(3)) + " s in " + data.segments.length +
      " segments. Drag to fit a stretch alone; a click takes it back."), box,
      el("div", { class: "tools" }, "Fit only from ", from, " to ", to, " s"));
  }

  function signalPlot(parent, data, i, title) {
    const t = [], v = [];
    data.segments.forEach((segment) => {
      segment.time_s.forEach((x, k) => { t.push(x); v.push(segment.values[i][k]); });
      if (segment.time_s.length) { t.push(t[t.length - 1] + 1e-6); v.push(null); }
    });
    const box = el("div", { class: "plot", role: "img", "aria-label": title + " over time" });
    parent.append(box);
    new uPlot({
      width: Math.max(240, work.clientWidth - 60), height: 140, legend: { show: false }, title: undefined,
      cursor: { sync: { key: "aligned" } }, scales: { x: { time: false } },
      axes: [{ stroke: () => colour("dim"), grid: { stroke: () => colour("grid") }, size: 28 },
        { stroke: () => colour("dim"), grid: { stroke: () => colour("grid") }, size: 62, label: title, labelSize: 18, labelFont: "12px system-ui", values: (u, x) => x.map(plain) }],
      series: [{}, { stroke: () => colour(i < data.signals.length - 1 ? "c1" : "c0"), width: 1.2, points: { show: false } }],
    }, [t, v], box);
  }

  // ---------------------------------------------------------------- the fit
  const fields = {
    recipe: el("select", {}, el("option", { value: "" }, "none: from a field to a field"), recipes.map((one) => el("option", { value: one.name }, one.name + (one.own ? " (own)" : "")))),
    from: el("input", { type: "text", placeholder: "STREAM.FIELD" }),
    to: el("input", { type: "text", placeholder: "STREAM.FIELD" }),
    effort: el("select", {}, ["quick", "normal", "thorough"].map((name) => el("option", { value: name, selected: name === "normal" }, name))),
    holdout: el("input", { type: "number", min: 0.05, max: 0.8, step: 0.05, value: "0.3" }),
    by: el("select", {}, ["auto", "flight", "time"].map((name) => el("option", { value: name }, name))),
    modes: el("input", { type: "text", placeholder: "all, or LOITER, ..." }),
    seed: el("input", { type: "number", value: "7" }),
    name: el("input", { type: "text", placeholder: "the recipe's name" }),
  };
  fields.recipe.value = recipe;
  const typed = Boolean(query.get("from") && query.get("to")); // two fields were dragged on the page Flights
  if (typed) { fields.from.value = query.get("from"); fields.to.value = query.get("to"); }
  const models = el("fieldset", {}, el("legend", {}, "Models besides ARX, OE and the references"), MODELS.map((name) =>
    el("label", { class: "tick" }, el("input", { type: "checkbox", value: name, checked: ["line", "static_ts", "ts"].includes(name) }), name)));
  const shownCommand = el("div", {});
  const running = el("div", {});
  const start = el("button", { class: "main", onclick: guarded(async () => {
    const job = await send("POST", "fits", body(false));
    running.replaceChildren(watch(job, () => {
      running.append(el("button", { class: "main", onclick: () => go("runs", { pick: "newest" }) }, "See the verdict"));
    }, stops));
  }) }, "Fit and validate");
  const row = (text, field) => el("label", {}, text, field);
  const quick = el("fieldset", {}, el("legend", {}, "Without a recipe: drag two fields, or type them"), row("From", fields.from), row("To", fields.to));
  right.append(el("h2", {}, "Fit"), row("Recipe", fields.recipe), quick, models, row("Effort of the search", fields.effort), row("Share held out", fields.holdout),
    row("Held out by", fields.by), row("Only in flight modes", fields.modes), row("Seed", fields.seed), row("Name of the run", fields.name), start, shownCommand, running,
    el("details", {}, el("summary", {}, "The recipe as TOML"), recipeEditor()));
  for (const [name, field] of Object.entries({ from: fields.from, to: fields.to })) {
    field.addEventListener("dragover", (event) => { if (event.dataTransfer.types.includes("text/x-field")) { event.preventDefault(); } });
    field.addEventListener("drop", (event) => {
      const dropped = event.dataTransfer.getData("text/x-field");
      if (dropped) { event.preventDefault(); fields[name].value = shown(dropped); command(); }
    });
  }

  function recipeEditor() {
    const text = el("textarea", { "aria-label": "Recipe as TOML", spellcheck: "false" });
    const name = el("input", { type: "text", placeholder: "name of your own recipe" });
    const load = guarded(async () => {
      if (!fields.recipe.value) { text.value = ""; return; }
      text.value = (await get("recipes/" + encodeURIComponent(fields.recipe.value))).toml;
      name.value = recipes.some((one) => one.name === fields.recipe.value && one.own) ? fields.recipe.value : fields.recipe.value + "-mine";
    });
    fields.recipe.addEventListener("change", load);
    load();
    const save = el("button", { onclick: guarded(async () => {
      await send("PUT", "recipes/" + encodeURIComponent(name.value), { toml: text.value });
      if (!recipes.some((one) => one.name === name.value)) {
        recipes.push({ name: name.value, own: true });
        fields.recipe.append(el("option", { value: name.value }, name.value + " (own)"));
      }
      fields.recipe.value = recipe = name.value;
      command();
    }) }, "Keep as a recipe of my own");
    return el("div", {}, text, el("label", {}, "Name", name), save);
  }

  function body(preview) {
    const ids = [...chosen.keys()].map((id) => id.split("|"));
    const own = ids.filter(([, name]) => name === fields.recipe.value);
    const chosenFlights = [...new Set([...own.map(([flight]) => flight), ...stretches.keys()])];
    const labels = [...models.querySelectorAll("input:checked")].map((box) => box.value);
    return {
      recipe: fields.recipe.value,
      inputs: fields.recipe.value || !fields.from.value ? [] : [fields.from.value],
      outputs: fields.recipe.value || !fields.to.value ? [] : [fields.to.value],
      channels: [...new Set(own.map(([, , channel]) => channel))],
      flights: typed && query.get("f") && !fields.recipe.value ? [query.get("f")] : chosenFlights.length < flights.length || count > flights.length ? chosenFlights : [],
      between,
      modes_flown: fields.modes.value.split(",").map((name) => name.trim()).filter(Boolean),
      models: labels.join(",") === "line,static_ts,ts" ? "" : labels.join(","),
      effort: fields.effort.value === "normal" ? "" : fields.effort.value,
      holdout: +fields.holdout.value === 0.3 ? null : +fields.holdout.value,
      by: fields.by.value === "auto" ? "" : fields.by.value,
      seed: +fields.seed.value === 7 ? null : +fields.seed.value,
      name: fields.name.value,
      preview,
    };
  }

  let asked = 0;
  async function command() { // what the page is about to run, to be copied
    const number = ++asked;
    quick.hidden = Boolean(fields.recipe.value);
    let told;
    if (!fields.recipe.value && !(fields.from.value && fields.to.value)) {
      start.disabled = true;
      shownCommand.replaceChildren(el("p", { class: "hint" }, "Choose a recipe, or an input and an output."));
      return;
    }
    try { told = await send("POST", "fits", body(true)); } catch (error) { told = { problem: error.message + (error.hint ? ": " + error.hint : "") }; }
    if (number !== asked) { return; }
    start.disabled = Boolean(told.problem);
    shownCommand.replaceChildren(told.problem ? el("p", { class: "hint" }, told.problem) : copyable(told.command + "\n" + told.then));
  }
  right.addEventListener("change", (event) => {
    if (event.target === fields.recipe) { recipe = fields.recipe.value; [...chosen.keys()].filter((id) => id.split("|")[1] !== recipe).forEach((id) => chosen.delete(id)); draw(); }
    command();
  });

  await Promise.all(flights.slice(0, LOOKED_AT).map(look));
  flights.slice(0, LOOKED_AT).forEach((flight) => { if (found.get(flight.id) && found.get(flight.id).state === "done") { preselect(flight.id); } });
  draw();
  command();
  const selected = (query.get("sel") || "").split("|");
  if (selected.length === 3) {
    const flight = flights.find((one) => one.id === selected[0]);
    const s = flight && found.get(flight.id) && found.get(flight.id).suggestions.find((one) => one.recipe === selected[1] && one.channel === selected[2]);
    if (s) { await open(flight, s); }
  }
  return () => stops.forEach((stop) => stop());
}
