// Jobs: every one is a command of the shell; its lines, its progress, cancel.
import { follow, get, send } from "./api.js";
import { copyable, el, guarded, plain } from "./page.js";

// A box that follows one job until it has ended; `ended` is told the job.
export function watch(job, ended, stay) {
  const bar = el("progress", { "aria-label": "Progress" });
  const state = el("p", { role: "status" }, job.state);
  const models = el("div", {});
  const log = el("pre", { tabindex: 0, "aria-label": "What it says" });
  const cancel = el("button", { onclick: guarded(async () => { await send("DELETE", "jobs/" + job.id); }) }, "Cancel");
  const box = el("section", { class: "job" }, bar, state, models, cancel, el("details", {}, el("summary", {}, "What it says"), log));
  const rows = new Map();
  stay.push(follow(job.id, (kind, told) => {
    if (kind === "line") {
      const step = progress(told);
      if (!step) { log.append(told + "\n"); state.textContent = told; return; }
      if (step.share !== undefined && step.share !== null) { bar.max = 1; bar.value = step.share; }
      state.textContent = [step.channel, step.model, step.stage].filter(Boolean).join(": ") + (step.seconds ? ", after " + plain(+step.seconds.toPrecision(2)) + " s" : "");
      if (step.channel && step.model) {
        const name = step.channel + ": " + step.model;
        if (!rows.has(name)) { rows.set(name, el("div", { class: "hint" })); models.append(rows.get(name)); }
        rows.get(name).textContent = name + " " + step.stage + (step.validation === undefined ? "" : ", validation error " + plain(+step.validation.toPrecision(3)));
      }
      return;
    }
    if (kind === "job") { state.textContent = told.state; return; }
    cancel.hidden = true;
    bar.max = 1;
    bar.value = told.state === "done" ? 1 : 0;
    state.textContent = told.state + (told.code === 3 ? ", with losses" : told.code === 4 ? ", a check failed" : "") +
      (told.began ? " after " + plain(+(told.ended - told.began).toPrecision(2)) + " s" : "");
    box.querySelector("details").open = told.state === "failed";
    ended(told);
  }));
  return box;
}

function progress(line) { // a line of --progress json, or null
  if (!line.startsWith("{")) { return null; }
  try { return JSON.parse(line); } catch { return null; }
}

export async function showJobs(main, query, stay) {
  const work = el("div", { class: "work" });
  main.append(work);
  const { jobs } = await get("jobs");
  work.append(el("h1", {}, "Jobs"));
  if (!jobs.length) { work.append(el("p", { class: "hint" }, "None yet. A job is a command: read a log, fit, validate, compare.")); }
  const wanted = query.get("j");
  for (const job of jobs.slice(0, 100)) {
    const body = el("div", {});
    const box = el("details", { open: job.id === wanted },
      el("summary", {}, job.state + " \u00b7 " + new Date(job.made * 1000).toLocaleString() + " \u00b7 " + job.words[0]), body);
    const fill = guarded(async () => {
      if (body.childElementCount || !box.open) { return; }
      stay.keep("jobs", { j: job.id });
      body.append(copyable(job.command), watch(job, () => {}, stay));
      const whole = await get("jobs/" + job.id);
      if (whole.out) { body.append(el("h2", {}, "Printed"), el("pre", { tabindex: 0 }, whole.out.slice(0, 20000))); }
    });
    box.addEventListener("toggle", fill);
    if (box.open) { fill(); }
    work.append(box);
  }
}
