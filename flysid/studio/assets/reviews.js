// The review of a flight above its plots: the answer, what to do next, and figures that lead to their curves.
import { get } from "./api.js";
import { el, plain } from "./page.js";

const ROOM_S = 5; // shown on either side of a moment

export async function reviewOf(parent, flight, plots) {
  const path = "flights/" + encodeURIComponent(flight.id);
  parent.dataset.flight = flight.id;
  parent.replaceChildren(el("p", { class: "hint", role: "status" }, "Reviewing the flight"));
  let found;
  try { found = await get(path + "/review"); } catch (error) {
    if (parent.dataset.flight === flight.id) { parent.replaceChildren(el("p", { class: "hint" }, "No review: " + error.message)); }
    return;
  }
  if (parent.dataset.flight !== flight.id) { return; } // another flight was opened meanwhile
  const [first, ...rest] = found.findings;
  parent.replaceChildren(...[
    el("p", { class: "headline " + first.grade }, lamp(first.grade), shows(first, first.text, plots), small(first.more)),
    rest.length && el("ul", { class: "findings" }, rest.map((one) => el("li", { class: one.grade }, lamp(one.grade), shows(one, one.text, plots), small(one.more)))),
    found.actions.length && el("div", { class: "next" }, el("h2", {}, "Do next"), el("ol", {}, found.actions.map((one) => el("li", {},
      el("b", {}, shows(one, one.title, plots)), one.changes.map((change) => el("code", {}, change.name + " " + plain(change.old) + " \u2192 " + plain(change.new) + " " + change.unit)),
      el("span", {}, " " + one.reason), one.predicted && el("span", {}, " Predicted: " + one.predicted), one.risk && el("span", { class: "hint" }, " Risk: " + one.risk))))),
    figures(found.sections, plots),
    frequencies(path),
    el("p", {}, el("a", { href: "/api/1/" + path + "/review.html", target: "_blank", rel: "noopener" }, "The whole page, with pictures")),
  ].filter(Boolean));
}

function figures(sections, plots) {
  const bodies = Object.values(sections).filter((section) => Object.keys(section.facts).length).map((section) => el("tbody", {},
    el("tr", {}, el("th", { colspan: "3", scope: "rowgroup" }, section.title)),
    Object.values(section.facts).map((fact) => el("tr", { class: fact.grade },
      el("td", {}, lamp(fact.grade), shows(fact, fact.label, plots)),
      el("td", {}, words(fact)), el("td", { class: "hint" }, fact.value === null ? fact.remedy : fact.note)))));
  return el("details", {}, el("summary", {}, "Every figure"), el("div", { class: "scroll", role: "region", tabindex: 0, "aria-label": "Figures" }, el("table", {}, bodies)));
}

function frequencies(path) { // spectrum and filters, computed when they are opened
  const words = el("pre", {}, "Computing the spectrum"), trial = el("div", { class: "scroll", role: "region", tabindex: 0, "aria-label": "Filters" });
  const picture = el("img", { class: "spectrum", alt: "Spectrum, and its map over throttle or time; the peaks stand below as text" });
  const tried = el("input", { type: "text", placeholder: "notch 86 40", "aria-label": "A filter to try: notch HZ WIDTH, pt1 HZ, biquad HZ" });
  const run = async () => {
    const more = tried.value.trim(), query = more ? "?more=" + encodeURIComponent(more) : "";
    try {
      const { rows, notes } = await get(path + "/filters" + query);
      trial.replaceChildren(el("table", {}, el("tbody", {}, rows.map((row) => el("tr", {}, row.map((cell) => el("td", {}, cell)))))), ...notes.map((note) => el("p", { class: "hint" }, note)));
    } catch (error) { trial.replaceChildren(el("p", { class: "hint" }, "No filters: " + error.message)); }
  };
  const load = async () => {
    picture.src = "/api/1/" + path + "/spectrum.svg";
    try { words.textContent = (await get(path + "/spectrum")).lines.join("\n"); } catch (error) { words.textContent = "No spectrum: " + error.message; picture.remove(); }
    await run();
  };
  const details = el("details", {}, el("summary", {}, "Spectrum and filters"), picture, words,
    el("form", { class: "try", onsubmit: (event) => { event.preventDefault(); run(); } }, tried, el("button", {}, "Try this filter")), trial);
  details.addEventListener("toggle", load, { once: true });
  return details;
}

function words(fact) {
  if (fact.value === null) { return "not determined" + (fact.missing ? ": " + fact.missing : ""); }
  if (typeof fact.value === "string") { return fact.value; }
  const three = (x) => plain(+x.toPrecision(3));
  return three(fact.value) + (fact.unit ? " " + fact.unit : "") + (fact.ci95 ? " [" + fact.ci95.map(three).join(", ") + "]" : "");
}

function shows(one, text, plots) { // a button that draws the evidence, where there is any
  if (!one.plots || !one.plots.length) { return text; }
  return el("button", { class: "evidence", title: "Plot " + one.plots.join(", "), onclick: () => {
    plots.add(one.plots);
    if (one.at_s !== null && one.at_s !== undefined) { plots.look(one.at_s - ROOM_S, one.at_s + ROOM_S); plots.mark(0, one.at_s); }
    plots.parent.lastElementChild.scrollIntoView({ block: "nearest" });
  } }, text);
}

function lamp(grade) {
  return [el("span", { class: "lamp " + grade, "aria-hidden": "true" }), grade === "watch" || grade === "bad" ? el("span", { class: "sr" }, grade + ": ") : null];
}

function small(text) { return text ? el("span", { class: "hint" }, " " + text) : null; }
