// A recipe as a form and as TOML: what is changed in one shows in the other; the server judges both.
import { get, send } from "./api.js";
import { advice, el, guarded } from "./page.js";

// Returns { box, load(name) }; `kept` is told the name under which a recipe was kept, `own` says whether a name is one's own.
export function recipeEditor(own, kept) {
  const text = el("textarea", { "aria-label": "Recipe as TOML", spellcheck: "false" });
  const name = el("input", { type: "text", placeholder: "name of your own recipe" });
  const said = el("p", { role: "status", class: "hint" });
  const form = el("div", {});
  const save = el("button", { onclick: guarded(async () => {
    const made = await send("PUT", "recipes/" + encodeURIComponent(name.value), { toml: text.value });
    said.textContent = "Kept as " + made.name + ".";
    kept(made.name);
  }) }, "Keep as a recipe of my own");

  async function judged(body) { // both ways through the server, which keeps nothing
    try {
      const found = await send("POST", "recipes", body);
      said.textContent = "";
      return found;
    } catch (error) { said.textContent = advice(error); return null; }
  }
  const toForm = async () => { const found = await judged({ toml: text.value }); if (found) { fill(found.form); save.disabled = false; } };
  const toText = async (document) => { // what the form holds is kept only where the TOML says it, too
    const found = await judged({ form: document });
    save.disabled = !found;
    if (found) { text.value = found.toml; }
  };
  const fill = (document) => form.replaceChildren(...formOf(document, () => toText(document), () => { fill(document); return toText(document); }));
  text.addEventListener("change", toForm);

  const load = guarded(async (recipe) => {
    said.textContent = "";
    save.disabled = false;
    const found = recipe ? await get("recipes/" + encodeURIComponent(recipe)) : { toml: "", form: { name: "mine", channels: {}, signals: {} } };
    text.value = found.toml;
    name.value = own(recipe) ? recipe : (recipe || "recipe") + "-mine";
    fill(found.form);
  });
  const box = el("details", { class: "recipe" }, el("summary", {}, "The recipe, as a form and as TOML"),
    el("div", { class: "two" }, form, el("div", {}, el("h3", {}, "As TOML"), text)), said,
    el("div", { class: "tools" }, el("label", {}, "Name", name), save));
  return { box, load };
}

// The form of a recipe; `changed` after a value, `redrawn` after a part came or went.
function formOf(document, changed, redrawn) {
  const signals = document.signals || (document.signals = {}), channels = document.channels || (document.channels = {});
  const others = Object.keys(document).filter((key) => !["name", "description", "rate_hz", "signals", "channels"].includes(key));
  return [
    el("h3", {}, "As a form"),
    field("Description", document, "description", changed),
    field("Rate, Hz, or auto", document, "rate_hz", changed),
    ...named("channel", channels, { inputs: [], outputs: [] }, redrawn, (one) => [
      field("Inputs", one, "inputs", changed, "list"), field("Outputs", one, "outputs", changed, "list")]),
    ...named("signal", signals, { unit: "", sources: [{ stream: "", field: "" }] }, redrawn, (one) => [
      field("Unit", one, "unit", changed), choice("Between samples", one, "hold", ["linear", "zero"], changed),
      ...(one.sources || []).map((source, i) => sourceOf(source, i, one, changed, redrawn)),
      el("button", { onclick: () => { one.sources.push({ stream: "", field: "" }); redrawn(); } }, "Another source")]),
    others.length ? el("p", { class: "hint" }, "Also there, to be changed as TOML: " + others.join(", ") + ".") : null,
    el("p", { class: "hint" }, "A change in the form writes the TOML anew, without comments."),
  ].filter(Boolean);
}

function named(kind, table, blank, redrawn, body) { // parts with a name each: renamed, added, removed
  const parts = Object.entries(table).map(([name, one]) => {
    const title = el("input", { type: "text", value: name, "aria-label": "Name of " + kind + " " + name });
    title.addEventListener("change", () => {
      if (!title.value || title.value in table) { title.value = name; return; }
      const renamed = Object.entries(table).map(([key, value]) => [key === name ? title.value : key, value]);
      renamed.forEach(([key]) => delete table[key]);
      delete table[name];
      Object.assign(table, Object.fromEntries(renamed));
      redrawn();
    });
    const gone = el("button", { "aria-label": "Remove " + kind + " " + name, onclick: () => { delete table[name]; redrawn(); } }, "Remove");
    return el("details", {}, el("summary", {}, kind + " " + name), el("div", { class: "tools" }, title, gone), ...body(one));
  });
  const add = el("button", { onclick: () => {
    let number = Object.keys(table).length + 1;
    while (kind + number in table) { number += 1; }
    table[kind + number] = structuredClone(blank);
    redrawn();
  } }, "Add a " + kind);
  return [...parts, add];
}

function sourceOf(source, i, signal, changed, redrawn) {
  return el("fieldset", {}, el("legend", {}, "Source " + (i + 1)),
    field("Stream", source, "stream", changed, "", "known-streams"), field("Field, or several", source, "field", changed, "some"),
    field("Transform", source, "transform", changed), field("Unit there", source, "unit", changed), field("Factor", source, "scale", changed, "number"),
    signal.sources.length > 1 ? el("button", { onclick: () => { signal.sources.splice(i, 1); redrawn(); } }, "Remove this source") : null);
}

function choice(label, part, key, values, changed) {
  const box = el("select", {}, values.map((value) => el("option", { selected: (part[key] || values[0]) === value }, value)));
  box.addEventListener("change", () => { part[key] = box.value; changed(); });
  return el("label", {}, label, box);
}

function field(label, part, key, changed, kind, list) { // an empty one is left to what a recipe takes by itself
  const shown = Array.isArray(part[key]) ? part[key].join(", ") : part[key] === undefined ? "" : String(part[key]);
  const box = el("input", { type: "text", value: shown });
  if (list) { box.setAttribute("list", list); }
  box.addEventListener("change", () => {
    const words = box.value.split(",").map((word) => word.trim()).filter(Boolean);
    const number = Number(box.value);
    if (kind === "list") { part[key] = words; }
    else if (!box.value.trim()) { delete part[key]; }
    else if (kind === "some" && words.length > 1) { part[key] = words; }
    else if ((kind === "number" || key === "rate_hz") && !Number.isNaN(number)) { part[key] = number; }
    else { part[key] = box.value.trim(); }
    changed();
  });
  return el("label", {}, label, box);
}
