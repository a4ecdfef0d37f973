// Runs: verdicts with scope and interval, two runs compared, the run's own page, its files.
import { address as path, get, send } from "./api.js";
import { advice, copyable, el, guarded, plain } from "./page.js";
import { explain, secondOf } from "./explain.js";
import { watch } from "./jobs.js";

export async function showRuns(main, query, stay) {
  const page = new Runs(main, query, await get("runs"), stay);
  page.draw();
  const run = page.runs.find((one) => one.id === page.open);
  if (run) { await page.show(run); }
}

class Runs {
  constructor(main, query, { runs, damaged }, stay) {
    Object.assign(this, { runs, stay });
    this.picked = new Set(query.getAll("pick").filter((id) => id !== "newest"));
    this.open = query.get("run") || (query.get("pick") === "newest" && runs.length ? runs[0].id : "");
    this.filter = el("input", { type: "search", "aria-label": "Find runs", placeholder: "recipe, verdict, ...", value: query.get("q") || "", oninput: () => this.changed() });
    this.differ = el("input", { type: "checkbox", checked: query.get("d") === "1", onchange: () => this.changed() });
    this.compare = el("button", { onclick: guarded(() => this.compared()) });
    this.table = el("div", { class: "scroll stacked", role: "region", "aria-label": "Runs", tabindex: 0 });
    this.below = el("section", { class: "run" });
    main.append(el("div", { class: "work" }, el("h1", {}, "Runs"),
      el("div", { class: "tools" }, this.filter, el("label", { class: "tick" }, this.differ, "only what differs"), this.compare), this.table,
      damaged.map((one) => el("p", { class: "hint" }, one.run + ": " + one.reason)), this.below));
  }

  changed() {
    this.stay.keep("runs", { q: this.filter.value, d: this.differ.checked ? "1" : "", pick: [...this.picked], run: this.open });
    this.draw();
  }

  rows() { // [run, channel] of all that hold the words
    const words = this.filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    return this.runs.flatMap((run) => run.channels.map((channel) => [run, channel]))
      .filter(([run, c]) => words.every((word) => [run.name, run.recipe, c.channel, c.verdict, c.scope].join(" ").toLowerCase().includes(word)));
  }

  draw() {
    const rows = this.rows(), columns = this.columns(rows);
    const focused = document.activeElement?.dataset.focus;
    this.compare.disabled = this.picked.size !== 2;
    this.compare.textContent = this.picked.size === 2 ? "Compare the two" : "Compare (tick two)";
    const head = el("tr", {}, columns.map(([title]) => el("th", { scope: "col" }, title)));
    const body = rows.map(([run, c]) => el("tr", { "data-open": run.id === this.open ? "yes" : null }, columns.map(([title, cell]) => el("td", { "data-label": title }, cell(run, c)))));
    this.table.replaceChildren(rows.length ? el("table", {}, el("thead", {}, head), el("tbody", {}, body))
      : el("p", { class: "hint" }, this.runs.length ? "No run has these words." : "No runs yet: fit on the page Channels."));
    if (focused) { this.table.querySelector('[data-focus="' + CSS.escape(focused) + '"]')?.focus(); }
  }

  columns(rows) { // [title, cell]; with "only what differs" those that are the same in all rows go
    const reach = Math.max(10, ...rows.flatMap(([, c]) => (c.interval_pct || [c.change_pct || 0]).map(Math.abs).filter(Number.isFinite)));
    const told = new Map(rows.map(([run]) => [run.id, settingsOf(run)])), names = [...new Set([...told.values()].flatMap((one) => [...one.keys()]))];
    const differing = names.filter((name) => new Set([...told.values()].map((one) => one.get(name) || "")).size > 1);
    const every = [
      ["compare", (run) => this.tick(run)],
      ["run", (run, c) => el("button", { onclick: guarded(() => this.show(run)), "data-focus": "show " + run.id + c.channel }, run.name)],
      ["channel", (run, c) => c.channel, (run, c) => c.channel],
      ["verdict", (run, c) => [el("b", {}, c.verdict), c.scope ? el("div", { class: "hint" }, c.scope) : null].filter(Boolean), (run, c) => c.verdict + c.scope],
      ["change in free-run error, 95 %", (run, c) => bar(c, reach)],
      ["fitted", (run) => run.fitted_at.slice(0, 16).replace("T", " "), (run) => run.fitted_at],
      ["recipe", (run) => run.recipe || "from a field to a field", (run) => run.recipe],
      ["errors", (run, c) => el("div", { class: "hint" }, Object.entries(c.rmse).slice(0, 6).map(([name, x]) => name + "\u00a0" + plain(+x.toPrecision(3))).join(", ") + " " + c.unit)],
      ["settings", (run) => el("div", { class: "hint" }, (this.differ.checked ? differing : names).filter((name) => told.get(run.id).has(name))
        .map((name, i) => [i ? ", " : "", name + "\u00a0", el(differing.includes(name) ? "b" : "span", {}, told.get(run.id).get(name))]))],
    ];
    return every.filter(([, , same]) => !this.differ.checked || !same || new Set(rows.map(([run, c]) => same(run, c))).size > 1);
  }

  tick(run) {
    return el("input", { type: "checkbox", checked: this.picked.has(run.id), "aria-label": "Compare " + run.name, "data-focus": "tick " + run.id, onchange: (event) => {
      if (event.target.checked) { this.picked.add(run.id); } else { this.picked.delete(run.id); }
      this.changed();
    } });
  }

  async show(run) {
    this.open = run.id;
    this.changed();
    this.below.replaceChildren(el("h2", {}, run.name), el("p", { class: "hint" }, run.folder));
    if (!run.judged) { await this.offerVerdict(run); return; }
    const worst = el("p", { role: "status" }, "Looking for the worst second"), explained = el("div", {});
    this.below.append(worst, explained, exports(run, (figures) => this.drawn(run, figures)),
      el("iframe", { title: "Report of " + run.name, sandbox: "allow-scripts allow-downloads", src: path("runs/" + run.id + "/report.html") }));
    try {
      const seconds = await get("runs/" + run.id + "/worst");
      worst.replaceChildren(...worstLines(seconds));
      explained.append(await explain(run, seconds));
    } catch (error) { worst.textContent = advice(error); }
  }

  async offerVerdict(run) {
    const told = await send("POST", "validates", { run: run.id, preview: true });
    const begin = el("button", { class: "main", onclick: guarded(async () => {
      const job = await send("POST", "validates", { run: run.id });
      begin.replaceWith(watch(job, guarded(() => this.again()), this.stay));
    }) }, "Validate");
    this.below.append(copyable(told.command), begin);
  }

  async drawn(run, figures) { // the report again, with figures as files
    const asked = { run: run.id, figures };
    const told = await send("POST", "validates", { ...asked, preview: true }), job = await send("POST", "validates", asked);
    this.below.querySelector(".exports").append(copyable(told.command), watch(job, guarded(() => this.again()), this.stay));
  }

  async again() {
    ({ runs: this.runs } = await get("runs"));
    const run = this.runs.find((one) => one.id === this.open);
    if (run) { await this.show(run); } else { this.draw(); }
  }

  async compared() {
    const [a, b] = [...this.picked], asked = { a, b };
    const told = await send("POST", "compares", { ...asked, preview: true }), job = await send("POST", "compares", asked);
    this.below.replaceChildren(el("h2", {}, "Compared on flights that neither has trained on"), copyable(told.command), watch(job, (ended) => {
      if (ended.state === "done") {
        this.below.append(el("iframe", { title: "Comparison", sandbox: "allow-scripts allow-downloads", src: path("comparisons/" + a + "-" + b + "/report.html") }));
      }
    }, this.stay));
  }
}

function settingsOf(run) { // name -> value of all that is set, as flat words
  const found = new Map();
  const walk = (part) => Object.entries(part).forEach(([name, value]) => {
    if (Array.isArray(value) ? value.length : value !== "" && value !== null && value !== false) {
      if (typeof value === "object" && !Array.isArray(value)) { walk(value); } else { found.set(name, [value].flat().join(", ")); }
    }
  });
  walk(run.settings);
  if (found.has("held")) { found.delete("holdout"); found.delete("by"); } // named, not chosen by chance
  return found;
}

function worstLines(seconds) { // one link a channel, back to the flight
  return Object.entries(seconds).map(([channel, one]) => {
    const words = "Worst second of " + channel + " (" + one.model + ")";
    if (!one.seen) { return el("span", {}, words + ": " + plain(+one.second_s.toFixed(1)) + " s of its segment. "); }
    const link = secondOf(one.seen, one.second_s);
    const query = new URLSearchParams(Object.entries(link).filter(([, value]) => value)).toString();
    return el("span", {}, words + ": ", el("a", { href: "#/flights?" + query }, plain(+(one.seen.begin_s + one.second_s).toFixed(1)) + " s of " + one.seen.flight), " ");
  });
}

function exports(run, draw) { // report, figures and models as files
  const link = (text, place, name) => el("a", { href: path(place), download: name }, text);
  const files = run.files.map((name) => [link(name, "runs/" + run.id + "/files/" + encodeURIComponent(name), name), " "]);
  const models = Object.entries(run.models).map(([channel, labels]) => el("p", {}, channel + ": ", labels.map((label) =>
    [link(label + ".json", "runs/" + run.id + "/models/" + encodeURIComponent(channel) + "/" + encodeURIComponent(label), channel + "-" + label + ".json"), " "])));
  const kind = el("select", { "aria-label": "Type of the figures" }, ["svg", "pdf", "png"].map((name) => el("option", {}, name)));
  return el("details", { class: "exports" }, el("summary", {}, "Export: report, figures, models"),
    el("p", {}, "Report: ", el("a", { href: path("runs/" + run.id + "/report.html"), target: "_blank", rel: "noopener" }, "on a page of its own"), " ", files), models,
    el("div", { class: "tools" }, "Figures for a paper as ", kind, el("button", { onclick: guarded(() => draw(kind.value)) }, "Draw them")));
}

function bar(c, reach) { // the change and its interval on a scale through zero
  if (c.change_pct === null || c.change_pct === undefined) { return "\u2013"; }
  const x = (value) => 110 + (100 * Math.max(-reach, Math.min(reach, value))) / reach;
  const [low, high] = c.interval_pct || [c.change_pct, c.change_pct];
  const words = plain(+c.change_pct.toPrecision(2)) + " %" + (c.interval_pct ? " [" + plain(+low.toPrecision(2)) + ", " + plain(+high.toPrecision(2)) + "]" : "");
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  Object.entries({ class: "interval", viewBox: "0 0 220 26", role: "img", "aria-label": words }).forEach(([name, value]) => svg.setAttribute(name, value));
  const line = (x1, y1, x2, y2, width, stroke) => {
    const one = document.createElementNS(svg.namespaceURI, "line");
    Object.entries({ x1, y1, x2, y2, "stroke-width": width, stroke }).forEach(([name, value]) => one.setAttribute(name, value));
    svg.append(one);
  };
  line(10, 20, 210, 20, 1, "currentColor");
  [-1, -0.5, 0, 0.5, 1].forEach((part) => line(110 + 100 * part, part ? 18 : 3, 110 + 100 * part, 22, 1, "currentColor"));
  line(x(low), 11, x(high), 11, 5, high < 0 ? "#137a45" : low > 0 ? "#c43a30" : "#7a7f8c");
  line(x(c.change_pct), 4, x(c.change_pct), 18, 3, "currentColor");
  return el("div", {}, words, svg);
}
