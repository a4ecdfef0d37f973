// The fit: recipe or two fields, models, what is held out; the command that it will be, the job that it becomes.
import { get, send } from "./api.js";
import { advice, copyable, el, go, guarded } from "./page.js";
import { watch } from "./jobs.js";
import { recipeEditor } from "./recipe.js";
import { takesField } from "./fields.js";

// The panel. `chosen()` gives [flight, recipe, channel] of every tick; `all` says whether these flights are every one there is;
// `picked` is told a recipe that was chosen, `knows` whether a recipe has channels to tick, `changed` that a recipe has been kept.
export class FitPanel {
  constructor({ recipes, models, query, parts, chosen, all, picked, knows, changed, stay }) {
    Object.assign(this, { recipes, parts, chosen, all, knows, changed, stay, asked: 0 });
    this.flight = query.get("f") || "";
    this.fields = this.makeFields(query);
    this.models = el("fieldset", { class: "models" }, el("legend", {}, "Models besides ARX, OE and the references"), models.map(({ name, usual }) =>
      el("label", { class: "tick" }, el("input", { type: "checkbox", value: name, checked: usual }), name)));
    this.usual = models.filter((one) => one.usual).map((one) => one.name).join(",");
    this.editor = recipeEditor((name) => this.recipes.some((one) => one.name === name && one.own), (name) => this.kept(name));
    this.command = el("div", {});
    this.running = el("div", {});
    this.taken = el("div", { class: "tools" });
    this.begin = el("button", { class: "main", onclick: guarded(() => this.run()) }, "Fit and validate");
    this.box = el("aside", { class: "right", "aria-label": "Fit" });
    this.layOut();
    this.box.addEventListener("change", (event) => {
      if (event.target === this.fields.recipe) { picked(this.fields.recipe.value); this.editor.load(this.fields.recipe.value); }
      this.told();
    });
    this.editor.load(this.recipe);
  }

  makeFields(query) {
    const field = (label) => el("input", { type: "text", placeholder: "STREAM.FIELD", list: "known-fields", "aria-label": label });
    const fields = {
      recipe: el("select", {}, el("option", { value: "" }, "none: from a field to a field"), this.recipes.map((one) => el("option", { value: one.name }, one.name + (one.own ? " (own)" : "")))),
      from: field("From"), to: field("To"),
      effort: el("select", {}, ["quick", "normal", "thorough"].map((name) => el("option", { value: name, selected: name === "normal" }, name))),
      holdout: el("input", { type: "number", min: 0.05, max: 0.8, step: 0.05, value: "0.3" }),
      by: el("select", {}, ["auto", "flight", "time"].map((name) => el("option", { value: name }, name))),
      modes: el("input", { type: "text", placeholder: "all, or LOITER, ..." }),
      seed: el("input", { type: "number", value: "7" }),
      name: el("input", { type: "text", placeholder: "the recipe's name" }),
    };
    fields.from.value = query.get("from") || "";
    fields.to.value = query.get("to") || "";
    this.typed = Boolean(fields.from.value && fields.to.value); // two fields were dragged on the page Flights
    fields.recipe.value = this.typed ? "" : query.get("r") || "";
    for (const box of [fields.from, fields.to]) { takesField(box, () => this.told()); }
    return fields;
  }

  layOut() {
    const { fields } = this, row = (text, field) => el("label", {}, text, field);
    this.quick = el("fieldset", {}, el("legend", {}, "Without a recipe: two fields"), row("From", fields.from), row("To", fields.to));
    this.share = row("Share held out", fields.holdout);
    this.box.append(el("h2", {}, "Fit"), row("Recipe", fields.recipe), this.quick, this.taken, this.begin, this.command, this.running, this.models,
      el("div", { class: "pairs" }, row("Effort of the search", fields.effort), this.share, row("Held out by", fields.by), row("Seed", fields.seed)),
      row("Only in flight modes", fields.modes), row("Name of the run", fields.name));
  }

  get recipe() { return this.fields.recipe.value; }

  set recipe(name) {
    if (name === this.recipe) { return; }
    this.fields.recipe.value = name;
    this.editor.load(name);
  }

  kept(name) { // a recipe of one's own is there now
    if (!this.recipes.some((one) => one.name === name)) {
      this.recipes.push({ name, own: true });
      this.fields.recipe.append(el("option", { value: name }, name + " (own)"));
    }
    this.fields.recipe.value = name;
    this.changed();
    this.told();
  }

  flights() {
    const ticked = this.chosen().filter(([, recipe]) => recipe === this.recipe).map(([flight]) => flight);
    if (this.typed && this.flight && !this.recipe) { return [this.flight]; }
    const ids = [...new Set(ticked)];
    return this.all(ids) ? [] : ids;
  }

  body(preview) {
    const { fields, recipe } = this, one = (field) => (recipe || !field.value ? [] : [field.value]);
    const labels = [...this.models.querySelectorAll("input:checked")].map((box) => box.value).join(",");
    const share = fields.holdout.value;
    return {
      recipe, inputs: one(fields.from), outputs: one(fields.to),
      channels: [...new Set(this.chosen().filter(([, name]) => name === recipe).map(([, , channel]) => channel))],
      flights: this.flights(), exclude: this.parts.out, holdout: this.parts.held.length ? this.parts.held : Number(share) === 0.3 ? [] : [share],
      modes_flown: fields.modes.value.split(",").map((name) => name.trim()).filter(Boolean),
      models: labels === this.usual ? "" : labels, effort: fields.effort.value === "normal" ? "" : fields.effort.value,
      by: fields.by.value === "auto" ? "" : fields.by.value, seed: Number(fields.seed.value) === 7 ? null : Number(fields.seed.value),
      name: fields.name.value, preview,
    };
  }

  async told() { // what the page is about to run, to be copied
    const number = ++this.asked, { recipe, fields } = this;
    this.quick.hidden = Boolean(recipe);
    this.share.hidden = this.parts.held.length > 0;
    this.taken.replaceChildren(...this.parts.list());
    const say = (content, can) => { this.begin.disabled = !can; this.command.replaceChildren(content); };
    if (!recipe && !(fields.from.value && fields.to.value)) { say(el("p", { class: "hint" }, "Choose a recipe, or an input and an output."), false); return; }
    if (recipe && this.knows(recipe) && !this.chosen().some(([, name]) => name === recipe)) { say(el("p", { class: "hint" }, "Tick a channel of " + recipe + "."), false); return; }
    try {
      const answer = await send("POST", "fits", this.body(true));
      if (number === this.asked) { say(copyable(answer.command + "\n" + answer.then), true); }
    } catch (error) { if (number === this.asked) { say(el("p", { class: "hint" }, advice(error)), false); } }
  }

  async run() {
    this.running.replaceChildren(this.fitting(await send("POST", "fits", this.body(false))));
  }

  async resume() { // what another page, or this one before a reload, has begun
    const { jobs } = await get("jobs");
    const going = (word) => jobs.filter((job) => job.words[0] === word && (job.state === "queued" || job.state === "running")).reverse();
    this.running.append(...going("fit").map((job) => this.fitting(job)), ...going("validate").map((job) => this.judging(job)));
  }

  fitting(fit) { // its box; behind it, when it is done, that of the job that judges, which begins by itself
    return watch(fit, guarded(async (ended) => {
      if (ended.state !== "done") { return; }
      const { jobs } = await get("jobs");
      const judging = jobs.find((job) => job.words[0] === "validate" && job.about.run === fit.about.run && job.made >= fit.made);
      if (judging) { this.running.append(this.judging(judging)); } else { this.see(); }
    }), this.stay);
  }

  judging(job) { return watch(job, () => this.see(), this.stay); }

  see() {
    const button = el("button", { class: "main", onclick: () => go("runs", { pick: "newest" }) }, "See the verdict");
    this.running.append(button);
    button.focus();
  }
}
