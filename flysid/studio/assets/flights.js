// Flights: drop a log, find a flight, drag its fields to plots.
import { Refused, follow, get, send } from "./api.js";
import { breakable, clock, date, el, go, guarded, plain, size } from "./page.js";
import { Plots, shown } from "./plots.js";
import { knownFields, takesField } from "./fields.js";
import { reviewOf } from "./reviews.js";

const MOST_FIELDS = 300; // listed at once; the search narrows them

export async function showFlights(main, query, stay) {
  const work = el("div", { class: "work" });
  const side = el("div", { class: "side" });
  main.append(side, work);

  const files = el("input", { type: "file", multiple: true, "aria-label": "Logs to add" });
  const arriving = el("div", { role: "status", class: "hint" });
  const drop = el("div", { class: "drop" }, "Drop logs here, or ", files, arriving);
  const find = el("input", { type: "search", placeholder: "name, vehicle, firmware", "aria-label": "Find flights" });
  const select = el("select", { "aria-label": "Flight" });
  const facts = el("div", { class: "hint" });
  const search = el("input", { type: "search", placeholder: "Find a field: roll, gyro, ... ( / )", "aria-label": "Find a field" });
  const tree = el("div", { class: "tree", tabindex: -1 });
  const ends = { from: el("input", { type: "text", placeholder: "drag or type" }), to: el("input", { type: "text", placeholder: "drag or type" }) };
  for (const field of Object.values(ends)) { takesField(field, () => {}); field.setAttribute("list", "known-fields"); }
  const identify = el("form", {}, el("label", {}, "Identify, from", ends.from), el("label", {}, "to", ends.to), el("button", {}, "Fit these"));
  identify.addEventListener("submit", (event) => {
    event.preventDefault();
    go("channels", { from: ends.from.value, to: ends.to.value, f: flight ? flight.id : "" });
  });
  const known = el("div", {});
  const fields = el("div", { class: "fields" }, search, tree, identify);
  const unfold = el("button", { class: "narrow", "aria-expanded": "false", onclick: () => {
    const isOpen = fields.classList.toggle("open");
    unfold.setAttribute("aria-expanded", String(isOpen));
  } }, "Fields");
  side.append(drop, el("label", {}, "Flight", find), select, facts, unfold, fields, known);

  const map = el("details", { class: "map" }, el("summary", {}, "Where it flew"));
  const events = el("details", {}, el("summary", {}, "Modes, messages and parameter changes"));
  const pairs = el("div", { class: "tools" });
  const plots = new Plots(el("div", {}), () => remember());
  const title = el("h1", {}, "Drop a log");
  const answer = el("section", { class: "answer", "aria-label": "Review" });
  const welcome = el("div", {}, el("p", {}, "Anywhere on this page: PX4 .ulg, ArduPilot .bin, MAVLink .tlog, ROS bags, MCAP, Betaflight, Crazyflie, AR.Drone, tables. It stays on this machine."),
    el("p", {}, "No log at hand? ", el("button", { onclick: () => trySample() }, "Try a simulated flight")));
  const foot = el("p", { class: "foot" },
    ...[["/", "find"], ["Enter", "add to a plot"], ["Shift Enter", "to the last plot"], ["\u2190 \u2192", "move"], ["+ \u2212", "zoom"], ["0", "all"],
      [", .", "first cursor"], ["< >", "second cursor"], ["x", "remove plot"]].flatMap(([k, what]) => [el("kbd", {}, k), " " + what + "  "]),
    "Drag on a plot zooms, a click sets the first cursor, Shift-click the second, double-click shows all.");
  work.append(title, welcome, answer, pairs, plots.parent, map, events, foot);
  let flight = null;
  const parts = [fields, unfold, select, find.parentElement, answer, pairs, plots.parent, map, events, foot];
  const reveal = (expected) => { // what needs a flight, where there is one or will be
    parts.forEach((part) => { part.hidden = !flight && !expected; });
    welcome.hidden = Boolean(flight || expected);
    if (flight) { title.textContent = flight.log; }
  };
  reveal();

  function remember() {
    if (!flight) { return; }
    const whole = plots.view[0] === 0 && plots.view[1] === plots.end;
    stay.keep("flights", {
      f: flight.id,
      p: plots.fields.map((names) => names.join(";")),
      t: whole ? "" : plots.view.join("~"),
      c: plots.marks.some((x) => x !== null) ? plots.marks.map((x) => (x === null ? "" : +x.toPrecision(9))).join("~") : "",
    });
  }

  const list = guarded(async (wanted) => {
    const found = await get("flights", { q: find.value, most: 200 });
    select.textContent = "";
    found.flights.forEach((one) => {
      const about = [clock(one.duration_s), date(one.start_utc_ns), one.info.vehicle || one.info.autopilot, one.info.firmware, one.losses ? "with losses" : ""];
      select.append(el("option", { value: one.id, selected: one.id === wanted }, one.log + " \u00b7 " + about.filter(Boolean).join(" \u00b7 ")));
    });
    if (found.count > found.flights.length) { select.append(el("option", { disabled: true }, "and " + (found.count - found.flights.length) + " more: search")); }
    if (!found.count) { facts.textContent = find.value ? "No flight has these words." : "No flights yet."; }
    return found;
  });

  const open = guarded(async (id, fields, view, marks) => {
    flight = await get("flights/" + encodeURIComponent(id));
    reveal();
    map.open = false;
    plots.open(flight, fields || firstPair(), view, marks); // what is beside the curves is made while they come
    facts.textContent = [
      flight.format, size(flight.size_bytes), flight.rows.toLocaleString("en") + " records", clock(flight.duration_s),
      date(flight.start_utc_ns) && date(flight.start_utc_ns) + " UTC", flight.info.vehicle || flight.info.autopilot, flight.info.firmware,
      flight.clocks.length > 1 ? flight.clocks.length + " boots" : "", flight.losses ? "lost: " + flight.losses : "",
    ].filter(Boolean).join(" \u00b7 ");
    listFields();
    listPairs();
    listEvents();
    known.replaceChildren(...knownFields(flight));
    reviewOf(answer, flight, plots);
    drawMap(null);
    remember();
  });

  function firstPair() {
    const found = flight.signals.find((group) => group.channels.length);
    return found ? [found.channels[0].map((name) => found.stream + ":" + name)] : [];
  }

  function listPairs() { // command beside measurement, one click
    pairs.textContent = "";
    const seen = new Set();
    flight.signals.forEach((group) => group.channels.forEach((names) => {
      const text = names.join(", ");
      if (seen.has(text) || seen.size >= 12) { return; }
      seen.add(text);
      pairs.append(el("button", { onclick: () => plots.add(names.map((name) => group.stream + ":" + name)), title: group.stream.slice(1) }, text));
    }));
    if (seen.size) { pairs.prepend(el("span", { class: "dim" }, "Plot:")); }
  }

  function listFields() {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    tree.textContent = "";
    let left = MOST_FIELDS;
    for (const group of [...flight.signals, ...flight.streams]) {
      const fields = group.fields.filter(([name]) => words.every((word) => (group.stream + "." + name).toLowerCase().includes(word)));
      if (!fields.length || left <= 0) { continue; }
      const title = group.stream.startsWith("@") ? "signals of " + group.stream.slice(1)
        : group.stream + " (" + group.rows.toLocaleString("en") + (group.rate_hz ? ", " + plain(+group.rate_hz.toPrecision(3)) + " Hz" : "") + ")";
      const items = el("ul", {});
      const box = el("details", { open: words.length > 0 }, el("summary", {}, breakable(title)), items);
      const fill = () => {
        if (items.childElementCount) { return; }
        fields.slice(0, MOST_FIELDS).forEach(([name, unit]) => items.append(el("li", {}, fieldButton(group.stream + ":" + name, unit))));
      };
      if (box.open) { fill(); left -= fields.length; } else { box.addEventListener("toggle", fill, { once: true }); }
      tree.append(box);
    }
    if (!tree.childElementCount) { tree.append(el("p", { class: "hint" }, "No field has these words.")); }
  }

  function fieldButton(name, unit) {
    const button = el("button", { draggable: "true", title: "Enter: a new plot. Shift-Enter: into the last plot." },
      shown(name).split(".").pop() + (unit ? ", " + unit : ""));
    button.addEventListener("click", (event) => plots.add([name], event.shiftKey ? plots.panels.length - 1 : undefined));
    button.addEventListener("dragstart", (event) => event.dataTransfer.setData("text/x-field", name));
    button.dataset.field = name;
    return button;
  }

  function listEvents() {
    events.querySelectorAll(".scroll").forEach((old) => old.remove());
    const rows = [...flight.modes.map(([at, , name]) => [at, "mode", name]), ...flight.moments].sort((a, b) => a[0] - b[0]);
    events.hidden = !rows.length;
    const table = el("table", {}, el("tbody", {}, rows.slice(0, 500).map(([at, kind, text]) => el("tr", {},
      el("td", {}, el("button", { onclick: () => { plots.look(at - 5, at + 5); plots.mark(0, at); } }, plain(at) + " s")),
      el("td", {}, kind), el("td", {}, text)))));
    events.append(el("div", { class: "scroll", role: "region", "aria-label": "Events", tabindex: 0 }, table));
  }

  async function drawMap(at) {
    if (!map.open) { map.querySelectorAll("svg,p").forEach((old) => old.remove()); return; }
    if (map.dataset.flight !== flight.id) {
      map.dataset.flight = flight.id;
      map.points = (await get("flights/" + encodeURIComponent(flight.id) + "/track")).points;
      map.querySelectorAll("svg,p").forEach((old) => old.remove());
    }
    if (!map.querySelector("svg,p")) { map.append(map.points.length ? track(map.points) : el("p", { class: "hint" }, "The log holds no positions.")); }
    const dot = map.querySelector("circle");
    if (!dot) { return; }
    const near = at === null ? null : map.points.reduce((a, b) => (Math.abs(b[0] - at) < Math.abs(a[0] - at) ? b : a));
    dot.setAttribute("visibility", near ? "visible" : "hidden");
    if (near) { const [x, y] = map.querySelector("svg").place(near); dot.setAttribute("cx", x); dot.setAttribute("cy", y); }
  }
  map.addEventListener("toggle", guarded(() => drawMap(plots.marks[0])));
  plots.told = (at) => { if (map.open) { drawMap(at); } };

  const take = guarded(async (dropped) => {
    for (const file of dropped) {
      arriving.textContent = file.name + ": sending " + size(file.size);
      const sent = await upload(file);
      const line = el("p", {}, file.name + ": reading");
      arriving.replaceChildren(line);
      get("uploads/" + sent.upload).then((look) => {
        if (look.streams && !line.dataset.done) {
          const rates = Object.entries(look.streams).slice(0, 6).map(([name, [, rate]]) => name + " " + plain(+rate.toPrecision(3)) + " Hz");
          line.textContent = file.name + ": " + look.format + ", " + Object.keys(look.streams).length + " streams (" + rates.join(", ") + ", ...); reading the rest";
        }
      }, () => {});
      await new Promise((resolve) => stay.push(follow(sent.job.id, guarded(async (kind, job) => {
        if (kind !== "ended") { return; }
        const ended = await get("jobs/" + job.id);
        const id = ended.out.trim().split("\n").filter(Boolean).pop();
        line.dataset.done = "yes";
        line.textContent = file.name + ": " + (ended.state === "done" ? "read" + (ended.code === 3 ? ", with losses" : "") : ended.state);
        if (ended.state !== "done" || !id) {
          const log = await fetchLog(job.id);
          line.append(el("pre", {}, log || "it is here already"));
        }
        await list(id);
        if (id) { select.value = id; await open(id); }
        resolve();
      }))));
    }
  });

  // A simulated flight is made by one job and taken in by the next.
  const trySample = guarded(async () => {
    arriving.textContent = "simulating a flight of a minute";
    const made = (await send("POST", "samples")).job;
    const simulated = await ended(made);
    if (simulated.state !== "done") { arriving.replaceChildren("a simulated flight: " + simulated.state, el("pre", {}, await fetchLog(made.id))); return; }
    let reading = null;
    while (!reading) {
      reading = (await get("jobs")).jobs.find((job) => job.about.sample === made.about.sample && job.id !== made.id);
      if (!reading) { await new Promise((resolve) => setTimeout(resolve, 200)); }
    }
    const read = await ended(reading);
    const id = (await get("jobs/" + read.id)).out.trim().split("\n").filter(Boolean).pop();
    arriving.textContent = id ? "a simulated flight: read" : "a simulated flight: " + read.state;
    await list(id);
    if (id) { select.value = id; await open(id); }
  });
  const ended = (job) => new Promise((resolve) => stay.push(follow(job.id, (kind, told) => { if (kind === "ended") { resolve(told); } })));

  files.addEventListener("change", () => take([...files.files]));
  for (const kind of ["dragover", "dragleave", "drop"]) {
    main.addEventListener(kind, (event) => {
      if (!event.dataTransfer || !event.dataTransfer.types.includes("Files")) { return; }
      event.preventDefault();
      drop.classList.toggle("over", kind === "dragover");
      if (kind === "drop") { take([...event.dataTransfer.files]); }
    });
  }
  select.addEventListener("change", () => open(select.value));
  let pause = 0;
  find.addEventListener("input", () => { clearTimeout(pause); pause = setTimeout(() => list(flight && flight.id), 200); });
  search.addEventListener("input", () => flight && listFields());
  tree.addEventListener("keydown", (event) => {
    const way = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    const stops = [...tree.querySelectorAll("summary,details[open] li button")];
    const at = stops.indexOf(document.activeElement);
    if (way && at >= 0 && stops[at + way]) { event.preventDefault(); stops[at + way].focus(); }
  });
  const slash = (event) => {
    if (event.key === "/" && !/^(INPUT|TEXTAREA|SELECT)$/.test(document.activeElement.tagName)) { event.preventDefault(); search.focus(); }
  };
  document.addEventListener("keydown", slash);
  stay.push(() => document.removeEventListener("keydown", slash));

  const numbers = (text) => (text ? text.split("~").map((x) => (x === "" ? null : +x)) : null);
  const drawn = query.getAll("p").map((names) => names.split(";"));
  const show = (id) => open(id, drawn.length ? drawn : null, numbers(query.get("t")), numbers(query.get("c")));
  if (query.get("f") && drawn.length) {
    reveal(true); // plots have their width only where they are shown
    plots.expect(query.get("f"), drawn, numbers(query.get("t")));
  }
  const listing = list(query.get("f"));
  if (query.get("f")) {
    await Promise.all([listing, show(query.get("f"))]);
    reveal();
  } else {
    const found = await listing;
    if (found && found.flights.length) { await show(found.flights[0].id); }
  }
}

async function upload(file) {
  try { return await send("POST", "uploads", file, { name: file.name }); } catch (error) {
    if (!(error instanceof TypeError)) { throw error; }
    await get("about"); // raises where it is the server that is gone
    throw new Refused({ message: file.name + " could not be read to its end: it was changed or removed meanwhile", hint: "drop it again when it is complete" });
  }
}

async function fetchLog(job) {
  return new Promise((resolve) => {
    const lines = [];
    follow(job, (kind, text) => { if (kind === "line") { lines.push(text); } else if (kind === "ended") { resolve(lines.join("\n")); } });
  });
}

function track(points) { // the path as it lies on the ground, without tiles
  const lat = points.map((p) => p[1]), lon = points.map((p) => p[2]);
  const middle = (Math.min(...lat) + Math.max(...lat)) / 2, shrink = Math.cos((middle * Math.PI) / 180);
  const left = Math.min(...lon), top = Math.max(...lat);
  const across = (Math.max(...lon) - left) * shrink || 1e-9, down = top - Math.min(...lat) || 1e-9;
  const scale = Math.min(560 / across, 160 / down);
  const place = ([, y, x]) => [20 + (x - left) * shrink * scale, 10 + (top - y) * scale];
  const ns = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(ns, "svg");
  svg.setAttribute("viewBox", "0 0 600 180");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", "The track, north up, " + plain(+(Math.max(across, down) * 111320).toPrecision(3)) + " m across");
  const line = document.createElementNS(ns, "polyline");
  line.setAttribute("points", points.map((p) => place(p).map((x) => x.toFixed(1)).join(",")).join(" "));
  line.setAttribute("fill", "none");
  line.setAttribute("stroke", "currentColor");
  const dot = document.createElementNS(ns, "circle");
  dot.setAttribute("r", 4);
  dot.setAttribute("fill", "#c2570c");
  dot.setAttribute("visibility", "hidden");
  svg.append(line, dot);
  svg.place = place;
  return svg;
}
