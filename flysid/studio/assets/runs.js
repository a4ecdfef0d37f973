// Runs: verdicts with scope and interval, two runs compared, the run's own page.
import { address as path, get, send } from "./api.js";
import { copyable, el, guarded, keep, plain } from "./page.js";
import { watch } from "./jobs.js";

export async function showRuns(main, query) {
  const stops = [];
  const work = el("div", { class: "work" });
  main.append(work);
  let { runs, damaged } = await get("runs");
  const picked = new Set((query.getAll("pick")).filter((id) => id !== "newest"));
  let open = query.get("run") || (query.get("pick") === "newest" && runs.length ? runs[0].id : "");
  const filter = el("input", { type: "search", "aria-label": "Find runs", placeholder: "recipe, channel, verdict, folder", value: query.get("q") || "" });
  const differ = el("input", { type: "checkbox", checked: query.get("d") === "1" });
  const compare = el("button", {}, "Compare");
  const table = el("div", { class: "scroll" }), below = el("section", {});
  work.append(el("h1", {}, "Runs"), el("div", { class: "tools" }, filter, el("label", { class: "tick" }, differ, "only settings that differ"), compare), table, below);
  damaged.forEach((one) => work.append(el("p", { class: "hint" }, one.run + ": " + one.reason)));

  function remember() { keep("runs", { q: filter.value, d: differ.checked ? "1" : "", pick: [...picked], run: open }); }

  function settings(run, names) {
    return names.map((name) => name + " " + JSON.stringify(run.settings[name])).join(", ");
  }

  function draw() {
    const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    const rows = runs.flatMap((run) => run.channels.map((channel) => [run, channel]))
      .filter(([run, c]) => words.every((word) => [run.name, run.recipe, c.channel, c.verdict, c.scope].join(" ").toLowerCase().includes(word)));
    const names = [...new Set(runs.flatMap((run) => Object.keys(run.settings)))]
      .filter((name) => !differ.checked || new Set(runs.map((run) => JSON.stringify(run.settings[name]))).size > 1);
    const reach = Math.max(10, ...rows.flatMap(([, c]) => (c.interval_pct || [c.change_pct || 0]).map(Math.abs).filter(Number.isFinite)));
    compare.disabled = picked.size !== 2;
    compare.textContent = picked.size === 2 ? "Compare the two" : "Compare (tick two)";
    const head = ["", "run", "fitted", "recipe", "channel", "verdict", "change in free-run error, 95 %", "errors", "settings"];
    table.replaceChildren(el("table", {}, el("thead", {}, el("tr", {}, head.map((text) => el("th", { scope: "col" }, text)))),
      el("tbody", {}, rows.map(([run, c]) => el("tr", { "aria-selected": run.id === open ? "true" : null },
        el("td", {}, el("input", { type: "checkbox", checked: picked.has(run.id), "aria-label": "Compare " + run.name, onchange: (event) => {
          if (event.target.checked) { picked.add(run.id); } else { picked.delete(run.id); }
          remember();
          draw();
        } })),
        el("td", {}, el("button", { onclick: () => show(run) }, run.name)),
        el("td", {}, run.fitted_at.slice(0, 16).replace("T", " ")),
        el("td", {}, run.recipe), el("td", {}, c.channel),
        el("td", {}, el("b", {}, c.verdict), c.scope ? el("div", { class: "hint" }, c.scope) : null),
        el("td", {}, bar(c, reach)),
        el("td", {}, Object.entries(c.rmse).slice(0, 6).map(([name, x]) => el("div", { class: "hint" }, name + " " + plain(+x.toPrecision(3)) + " " + c.unit))),
        el("td", { class: "hint" }, settings(run, names)))))));
    if (!rows.length) { table.replaceChildren(el("p", { class: "hint" }, runs.length ? "No run has these words." : "No runs yet: fit on the page Channels.")); }
  }

  const show = guarded(async (run) => {
    open = run.id;
    remember();
    draw();
    below.replaceChildren(el("h2", {}, run.name), el("p", { class: "hint" }, run.folder));
    if (!run.judged) {
      const told = await send("POST", "validates", { run: run.id, preview: true });
      const begin = el("button", { class: "main", onclick: guarded(async () => {
        const job = await send("POST", "validates", { run: run.id });
        begin.replaceWith(watch(job, again, stops));
      }) }, "Validate");
      below.append(copyable(told.command), begin);
      return;
    }
    const frame = el("iframe", { title: "Report of " + run.name, sandbox: "allow-scripts allow-downloads", src: path("runs/" + run.id + "/report.html") });
    const { explain } = await import("./explain.js");
    below.append(el("p", {}, el("a", { href: path("runs/" + run.id + "/report.html"), target: "_blank", rel: "noopener" }, "The report on a page of its own"),
      " \u00b7 as files: ", el("code", {}, run.folder + "/report")));
    below.append(await explain(run), frame);
  });

  const again = guarded(async () => {
    ({ runs, damaged } = await get("runs"));
    draw();
    const run = runs.find((one) => one.id === open);
    if (run) { await show(run); }
  });

  compare.addEventListener("click", guarded(async () => {
    const [a, b] = [...picked];
    const told = await send("POST", "compares", { a, b, preview: true });
    const job = await send("POST", "compares", { a, b });
    below.replaceChildren(el("h2", {}, "Compared on flights that neither has trained on"), copyable(told.command), watch(job, (ended) => {
      if (ended.state === "done") {
        below.append(el("iframe", { title: "Comparison", sandbox: "allow-scripts", src: path("comparisons/" + a + "-" + b + "/report.html") }));
      }
    }, stops));
  }));
  filter.addEventListener("input", () => { remember(); draw(); });
  differ.addEventListener("change", () => { remember(); draw(); });
  draw();
  const run = runs.find((one) => one.id === open);
  if (run) { await show(run); }
  return () => stops.forEach((stop) => stop());
}

function bar(c, reach) { // the change and its interval on a scale through zero
  if (c.change_pct === null || c.change_pct === undefined) { return "\u2013"; }
  const x = (value) => 110 + (100 * Math.max(-reach, Math.min(reach, value))) / reach;
  const ns = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(ns, "svg");
  svg.setAttribute("class", "interval");
  svg.setAttribute("viewBox", "0 0 220 26");
  const [low, high] = c.interval_pct || [c.change_pct, c.change_pct];
  const words = plain(+c.change_pct.toPrecision(2)) + " %" + (c.interval_pct ? " [" + plain(+low.toPrecision(2)) + ", " + plain(+high.toPrecision(2)) + "]" : "");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", words);
  const line = (x1, y1, x2, y2, width, stroke) => {
    const one = document.createElementNS(ns, "line");
    Object.entries({ x1, y1, x2, y2, "stroke-width": width, stroke }).forEach(([name, value]) => one.setAttribute(name, value));
    svg.append(one);
  };
  line(10, 20, 210, 20, 1, "currentColor");
  [-1, -0.5, 0, 0.5, 1].forEach((part) => line(110 + 100 * part, part ? 18 : 3, 110 + 100 * part, 22, 1, "currentColor"));
  line(x(low), 11, x(high), 11, 5, high < 0 ? "#137a45" : low > 0 ? "#c43a30" : "#7a7f8c");
  line(x(c.change_pct), 4, x(c.change_pct), 18, 3, "currentColor");
  return el("div", {}, words, svg);
}
