// Live: links and the file, measurement beside the model as it comes, alarms with their reasons.
import { address, get } from "./api.js";
import { clock, colour, complain, el, plain, size, swatch } from "./page.js";
import { axes } from "./plots.js";

const KEPT_S = 600, LEAST_S = 2, SILENT_S = 5;

export async function showLive(main, _query, stay) {
  const about = await get("live");
  const view = { span: 30, end: null, newest: 0 }; // `end` null: the newest samples are followed
  const state = el("div", { class: "scroll", role: "region", "aria-label": "Links and systems", tabindex: 0 }), warnings = el("ul", { class: "hint" }), file = el("p", { role: "status" });
  const alarms = el("ul", { "aria-live": "assertive" }), none = el("p", { class: "hint" }, "None yet.");
  const follow = el("button", { "aria-pressed": "true", onclick: () => pause(view.end === null ? view.newest : null) }, "Following");
  const shown = el("span", { class: "hint" });
  const charts = about.channels.flatMap((channel) => channel.outputs.map((output, j) => new Chart(channel, output, j, view, changed)));
  const work = el("div", { class: "work" },
    el("h1", {}, "Live: " + about.links.join(", ")), file,
    charts.length
      ? [el("div", { class: "tools" }, follow,
        el("button", { onclick: () => look(view.span / 1.5) }, "Shorter"), el("button", { onclick: () => look(view.span * 1.5) }, "Longer"), shown),
      el("p", { class: "hint" }, swatch("ink"), " measured ", swatch("c0"), " expected one step ahead ", swatch("c1"),
        " free run, with the band that holds 99.5 % of nominal samples. Wheel or + and \u2212 change the window; arrows and drag look back.")]
      : el("p", { class: "hint" }, "No model is watched. Start the studio with --watch RUN to see one beside the link."),
    charts.map((chart) => chart.box),
    el("h2", {}, "Alarms and remarks"), none, alarms,
    el("h2", {}, "Links"), state, warnings);
  main.append(work);
  charts.forEach((chart) => chart.build());

  function changed() {
    follow.setAttribute("aria-pressed", view.end === null ? "true" : "false");
    follow.textContent = view.end === null ? "Following" : "Paused: follow again";
    shown.textContent = plain(+view.span.toPrecision(2)) + " s shown";
    charts.forEach((chart) => chart.draw());
  }
  function pause(end) { view.end = end; changed(); }
  function look(span) { view.span = Math.min(Math.max(span, LEAST_S), KEPT_S); changed(); }

  const source = new EventSource(address("live/events"));
  source.addEventListener("news", (event) => {
    complain(null);
    const news = JSON.parse(event.data);
    charts.forEach((chart) => chart.take(news.channels[chart.channel.name]));
    view.newest = Math.max(...charts.map((chart) => chart.newest));
    news.events.forEach(remark);
    charts.forEach((chart) => chart.draw());
  });
  source.addEventListener("state", (event) => tell(JSON.parse(event.data)));
  source.onerror = () => { if (source.readyState !== EventSource.OPEN) { complain(new TypeError("fetch: the server is gone")); } };

  function remark(one) {
    none.hidden = true;
    const alarm = one.kind === "alarm";
    alarms.prepend(el("li", { class: alarm ? "alarm" : "hint" }, (alarm ? "ALARM " : "") + plain(+one.time_s.toFixed(2)) + " s: " + one.text));
    while (alarms.childElementCount > 200) { alarms.lastChild.remove(); }
    if (alarm) { charts.forEach((chart) => chart.alarm(one)); }
  }

  function tell(now) {
    const how = now.refusal ? now.refusal + ": receiving goes on, nothing is written" : now.is_alive ? "recording" : "ended";
    file.textContent = how + " \u00b7 " + now.file + " \u00b7 " + now.frames.toLocaleString() + " frames \u00b7 " + size(now.bytes) +
      " \u00b7 " + clock(now.updated_s - now.started_s);
    file.className = now.refusal ? "alarm" : "";
    const rows = now.links.flatMap((link) => {
      const dropped = link.dropped_by_host === null ? "not known" : link.dropped_by_host.toLocaleString();
      const senders = link.peers.flatMap((peer) => peer.systems.map((one) => [peer, one]));
      const garbage = link.peers.reduce((sum, peer) => sum + peer.bytes_that_are_no_frame, 0);
      const how = [link.state, link.silent_s > SILENT_S && "silent for " + clock(link.silent_s), garbage && garbage.toLocaleString() + " bytes that are no frame"]
        .filter(Boolean).join(", ");
      if (!senders.length) { return [row([link.link, how, garbage ? "no frame has come" : "nothing has come", "", "", "", dropped])]; }
      return senders.map(([peer, one]) => row([link.link, how, peer.peer + ", system " + one.system + "." + one.component,
        one.frames.toLocaleString(), one.lost_by_sequence.toLocaleString(), one.lost_in_silence_about.toLocaleString(), dropped]));
    });
    const head = ["Link", "State", "Sender", "Frames", "Lost by sequence", "Lost in silence, about", "Dropped by this host"];
    state.replaceChildren(el("table", {}, el("thead", {}, el("tr", {}, head.map((text) => el("th", { scope: "col" }, text)))), el("tbody", {}, rows)));
    charts.forEach((chart) => chart.say(now.channels[chart.channel.name]));
    warnings.replaceChildren(...now.warnings.map((text) => el("li", {}, text)));
  }
  changed();
  main.live = { charts, view };
  stay.push(() => { source.close(); charts.forEach((chart) => chart.close()); });
}

const row = (cells) => el("tr", {}, cells.map((text) => el("td", {}, text)));

class Chart { // one output of a channel
  constructor(channel, output, j, view, changed) {
    Object.assign(this, { channel, output, j, view, changed });
    this.nearest = el("span", { class: "value" });
    this.state = el("span", { class: "hint", role: "status" });
    this.chart = el("div", { class: "chart", tabindex: 0, role: "img", "aria-label": output.name + ": measured, expected, free run" });
    this.box = el("section", { class: "plot" }, el("div", { class: "head" }, el("b", {}, output.name + (output.unit ? ", " + output.unit : "")),
      el("span", { class: "hint" }, "from " + channel.inputs.join(", ")), this.nearest, this.state), this.chart);
    this.newest = -Infinity;
    this.marks = [];
    this.forget(0);
    this.chart.addEventListener("keydown", (event) => this.press(event));
    this.resize = () => this.plot && this.plot.setSize({ width: this.width(), height: 190 });
    window.addEventListener("resize", this.resize);
  }

  forget(first) { // rows before `first` are not known
    this.first = first;
    this.rows = []; // [time, measured, expected, free run]
  }

  take(news) { // rows that come again replace those with their numbers
    if (!news) { return; }
    const n = this.channel.outputs.length;
    if (news.first > this.first + this.rows.length || news.first < this.first) { this.forget(news.first); }
    this.rows.length = news.first - this.first;
    for (const row of news.rows) { this.rows.push([row[0], row[1 + this.j], row[1 + n + this.j], row[1 + 2 * n + this.j]]); }
    for (let k = this.rows.length - 1; k > 0; k--) { // the vehicle's clock was set back: what was before cannot be drawn with it
      if (this.rows[k][0] <= this.rows[k - 1][0]) { this.rows.splice(0, k); this.first += k; this.marks = []; break; }
    }
    const most = Math.round(KEPT_S / this.channel.dt_s), old = this.rows.length - most;
    if (old > most / 10) { this.rows.splice(0, old); this.first += old; }
    if (this.rows.length) { this.newest = this.rows[this.rows.length - 1][0]; }
    const ratio = news.nearest[this.output.name];
    if (ratio !== undefined) { this.nearest.textContent = "at " + Math.round(100 * ratio) + " % of the alarm"; }
    this.nearest.classList.toggle("alarm", ratio > 1);
  }

  say(state) { // what is judged needs no word
    this.state.textContent = state === "judged" ? "" : state;
    this.nearest.hidden = state !== "judged";
  }

  alarm(event) {
    if (event.channel === this.channel.name && event.output === this.output.name) { this.marks.push([event.since_s, event.time_s]); }
  }

  width() { return Math.max(240, (this.box.parentElement || this.box).clientWidth - 44); }

  build() {
    const line = (name, dash) => ({ stroke: () => colour(name), width: 1.4, dash, points: { show: false }, spanGaps: false });
    const edge = { stroke: "transparent", points: { show: false }, spanGaps: false };
    this.plot = new uPlot({
      width: this.width(), height: 190, legend: { show: false }, cursor: { sync: { key: "live" }, drag: { x: false, y: false } },
      scales: { x: { time: false, range: (u, min, max) => [min, max] }, y: { range: (u, min, max) => (min === null ? [0, 1] : uPlot.rangeNum(min, max, 0.1, true)) } },
      axes: axes(),
      series: [{}, edge, edge, line("c1", [6, 4]), line("c0"), line("ink")],
      bands: [{ series: [2, 1], fill: () => colour("c1") + "2e" }],
      hooks: { drawClear: [(plot) => this.behind(plot)] },
    }, [[0], [null], [null], [null], [null], [null]], this.chart);
    this.plot.over.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? 1 / 1.3 : 1.3);
    }, { passive: false });
    this.plot.over.addEventListener("pointerdown", (event) => { this.plot.over.setPointerCapture(event.pointerId); this.grip = [event.clientX, this.end()]; });
    this.plot.over.addEventListener("pointermove", (event) => {
      if (!this.grip || !(event.buttons & 1)) { return; }
      this.move(this.grip[1] - (event.clientX - this.grip[0]) / this.plot.over.clientWidth * this.view.span);
    });
    this.plot.over.addEventListener("pointerup", () => { this.grip = null; });
  }

  end() { return this.view.end === null ? this.view.newest : this.view.end; }

  move(end) { // beyond the newest sample: follow again
    this.view.end = end >= this.view.newest ? null : end;
    this.changed();
  }

  zoom(factor) { // following goes on
    this.view.span = Math.min(Math.max(this.view.span * factor, LEAST_S), KEPT_S);
    this.changed();
  }

  press(event) {
    const step = { ArrowLeft: -0.2, ArrowRight: 0.2 }[event.key], factor = { "+": 1 / 1.3, "=": 1 / 1.3, "-": 1.3 }[event.key];
    if (step) { this.move(this.end() + step * this.view.span); }
    else if (factor) { this.zoom(factor); }
    else if (event.key === " ") { this.move(this.view.end === null ? this.view.newest - 1e-6 : Infinity); }
    else { return; }
    event.preventDefault();
  }

  behind(plot) { // since when it was outside, and when that was said
    const pen = plot.ctx, box = plot.bbox;
    pen.save();
    pen.beginPath();
    pen.rect(box.left, box.top, box.width, box.height);
    pen.clip();
    for (const [since, at] of this.marks) {
      const a = plot.valToPos(since, "x", true), b = plot.valToPos(at, "x", true);
      pen.fillStyle = colour("bad-bg");
      pen.fillRect(a, box.top, b - a, box.height);
      pen.fillStyle = colour("bad");
      pen.fillRect(Math.round(b), box.top, 2, box.height);
    }
    pen.restore();
  }

  draw() {
    if (!this.plot || !this.rows.length) { return; }
    const end = this.end(), start = end - this.view.span, { band } = this.output, gap = 3 * this.channel.dt_s;
    const columns = [[], [], [], [], [], []];
    const put = (t, measured, expected, free) => [t, free === null ? null : free - band, free === null ? null : free + band, free, expected, measured]
      .forEach((value, k) => columns[k].push(value));
    let before = null;
    for (const [t, measured, expected, free] of this.rows) {
      if (t < start || t > end) { continue; }
      if (before !== null && t - before > gap) { put((before + t) / 2, null, null, null); }
      put(t, measured, expected, free);
      before = t;
    }
    this.plot.batch(() => {
      this.plot.setData(columns, false);
      this.plot.setScale("x", { min: start, max: end });
      const seen = columns.slice(1).flat().filter((x) => x !== null);
      const low = Math.min(...seen), high = Math.max(...seen);
      this.plot.setScale("y", seen.length ? { min: low, max: high } : { min: 0, max: 1 });
    });
  }

  close() {
    window.removeEventListener("resize", this.resize);
    if (this.plot) { this.plot.destroy(); }
  }
}
