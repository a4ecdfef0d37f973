(function () {
  "use strict";
  var held = null;
  var root = document.documentElement;
  var charts = [];

  if (matchMedia("(max-width:900px)").matches) { // where tables stack, details wait to be opened
    document.querySelectorAll("details.fold").forEach(function (fold) { fold.open = false; });
  }

  function data(index) { // read when the first chart is drawn, not when the page opens
    held = held || JSON.parse(document.getElementById("data").textContent);
    return held[index];
  }

  function colour(name) {
    return getComputedStyle(root).getPropertyValue("--" + name).trim();
  }

  function plain(value) {
    return value === null ? "" : String(+value.toPrecision(9)).replace("-", "\u2212");
  }

  function series(label, css, dash, width) {
    return { label: label, stroke: function () { return colour(css); }, width: width, dash: dash, points: { show: false } };
  }

  function axes(showTime, low) {
    var ink = function () { return colour("dim"); };
    var grid = { stroke: function () { return colour("grid"); }, width: 1 };
    return [
      { stroke: ink, grid: grid, ticks: { show: false }, size: showTime ? 40 : 8, values: showTime ? undefined : function (u, v) { return v.map(function () { return ""; }); }, label: showTime ? "time, s" : undefined, labelSize: 16, font: "11px system-ui", labelFont: "11px system-ui" },
      { stroke: ink, grid: grid, ticks: { show: false }, size: 56, space: low ? 16 : 30, font: "11px system-ui", values: function (u, v) { return v.map(plain); } }
    ];
  }

  function title(parent, text) {
    var p = document.createElement("p");
    p.className = "panel-title";
    p.textContent = text;
    parent.appendChild(p);
  }

  function full(thin, n) { // a band is kept at every fourth sample: straight lines between
    var out = new Array(n), last = thin.length - 1;
    for (var i = 0; i < n; i++) {
      var k = Math.min(i >> 2, last), next = Math.min(k + 1, last), part = (i & 3) / 4;
      out[i] = thin[k] === null || thin[next] === null ? null : thin[k] + part * (thin[next] - thin[k]);
    }
    return out;
  }

  function shade(current, plot) { // 95 % bands below the lines
    if (!current.bands.length) { return; }
    var pen = plot.ctx, box = plot.bbox;
    pen.save();
    pen.beginPath();
    pen.rect(box.left, box.top, box.width, box.height);
    pen.clip();
    pen.globalAlpha = 0.18;
    current.bands.forEach(function (band) {
      var n = current.t.length, low = full(band[1], n), high = full(band[2], n), i;
      pen.fillStyle = colour(band[0]);
      pen.beginPath();
      for (i = 0; i < n; i++) { pen.lineTo(plot.valToPos(current.t[i], "x", true), plot.valToPos(high[i], "y", true)); }
      for (i = n - 1; i >= 0; i--) { pen.lineTo(plot.valToPos(current.t[i], "x", true), plot.valToPos(low[i], "y", true)); }
      pen.closePath();
      pen.fill();
    });
    pen.restore();
  }

  function chart(parent, height, channel, lines, range, showTime, key) {
    var options = {
      width: Math.max(260, parent.clientWidth),
      height: height,
      legend: { show: false },
      cursor: { sync: { key: key }, drag: { x: true, y: false } },
      scales: { x: { time: false }, y: { range: function () { return range(); } } },
      axes: axes(showTime, height < 150),
      series: [{}].concat(lines)
    };
    var plot = new uPlot(options, [[0], [0]].slice(0, 1).concat(lines.map(function () { return [0]; })), parent);
    charts.push({ plot: plot, parent: parent, height: height });
    return plot;
  }

  function draw(figure, channel, index) {
    var live = figure.querySelector(".live");
    var current = channel.segments[channel.shown];
    var key = "channel" + index;
    live.hidden = false;
    var models = channel.models.map(function (name, i) {
      return series(name, ownColour(i), i === 0 ? [5, 3] : undefined, 1.6);
    });
    var picked = channel.names.length - channel.models.length; // the others are models drawn, some steps ahead
    var others = channel.others.map(function (name, i) {
      var line = i < picked ? series(name, otherColour(i), [2, 2], 1.6) : series(name, ownColour(i - picked), [1, 3], 1.6);
      line.show = false;
      return line;
    });
    title(live, channel.titles[0]);
    var top = chart(live, 230, channel, models.concat(others, [series("measured", "measured", undefined, 1.3)]), function () { return current.range; }, false, key);
    var strip = document.createElement("canvas");
    strip.className = "strip";
    strip.setAttribute("aria-hidden", "true");
    live.appendChild(strip);
    title(live, channel.titles[1]);
    var middle = chart(live, 110, channel, models, function () { return current.error_range; }, false, key);
    title(live, channel.titles[2]);
    var bottom = chart(live, 120, channel, [series(channel.titles[2], "dim", undefined, 1.1)], function () { return current.input_range; }, true, key);

    function paintStrip() {
      if (!current.runs.length) { strip.hidden = true; return; }
      strip.hidden = false;
      var ratio = window.devicePixelRatio || 1;
      strip.width = strip.clientWidth * ratio;
      strip.height = strip.clientHeight * ratio;
      var pen = strip.getContext("2d");
      pen.clearRect(0, 0, strip.width, strip.height);
      pen.save();
      var left = top.bbox.left, width = top.bbox.width;
      pen.beginPath();
      pen.rect(left, 0, width, strip.height);
      pen.clip();
      current.runs.forEach(function (run) {
        var a = top.valToPos(run[0], "x", true), b = top.valToPos(run[1], "x", true);
        pen.fillStyle = colour("r" + (run[2] % 8 + 1));
        pen.fillRect(a, 0, Math.max(b - a, 0.5), strip.height);
      });
      pen.restore();
    }
    var zooming = false;
    function follow(source) {
      return function (plot, scale) {
        if (scale !== "x" || zooming) { return; }
        zooming = true;
        [top, middle, bottom].forEach(function (other) {
          if (other !== source()) { other.setScale("x", { min: plot.scales.x.min, max: plot.scales.x.max }); }
        });
        zooming = false;
        paintStrip();
      };
    }
    function show(i) {
      current = channel.segments[i];
      zooming = true;
      others = current.others.map(function (values) { return spread(values, current.t.length); });
      top.setData([current.t].concat(current.models, others, [current.y])); // the measurement lies on top
      middle.setData([current.t].concat(current.errors));
      bottom.setData([current.t, current.u]);
      zooming = false;
      paintStrip();
    }
    var moves = { ArrowLeft: [-0.2, -0.2], ArrowRight: [0.2, 0.2], "+": [0.25, -0.25], "=": [0.25, -0.25], "-": [-0.5, 0.5], "0": null };
    figure.tabIndex = 0;
    figure.addEventListener("keydown", function (event) { // what the mouse does by dragging
      var move = moves[event.key], x = top.scales.x, t = current.t;
      if (move === undefined || event.ctrlKey || event.metaKey || event.altKey) { return; }
      event.preventDefault();
      var first = t[0], last = t[t.length - 1], span = x.max - x.min;
      var low = move ? x.min + move[0] * span : first, high = move ? x.max + move[1] * span : last;
      if (move && move[0] === move[1]) { low = Math.max(first, Math.min(low, last - span)); high = low + span; }
      low = Math.max(low, first);
      high = Math.min(high, last);
      if (high - low > 3 * (t[1] - t[0])) { top.setScale("x", { min: low, max: high }); }
    });
    top.hooks.drawAxes = [function (plot) { shade(current, plot); }];
    [[top, 0], [middle, 1], [bottom, 2]].forEach(function (item) {
      item[0].hooks.setScale = (item[0].hooks.setScale || []).concat([follow(function () { return item[0]; })]);
    });
    show(channel.shown);
    figure.querySelector(".still").setAttribute("hidden", "");
    charts.push({ paint: paintStrip });
    var section = figure.closest(".channel"), picks = section.querySelector(".picks.models");
    function reveal(name, on) { // every picture of the section has a part for each model
      section.querySelectorAll("[data-model]").forEach(function (part) {
        if (part.dataset.model === name) { part.toggleAttribute("hidden", !on); }
      });
    }
    channel.models.forEach(function (name, i) {
      press(picks, channel.names[i].toUpperCase(), ownColour(i), true, function (on) {
        top.setSeries(1 + i, { show: on });
        middle.setSeries(1 + i, { show: on });
        reveal(channel.names[i], on);
      });
    });
    channel.others.forEach(function (name, i) {
      press(picks, name, i < picked ? otherColour(i) : ownColour(i - picked), false, function (on) {
        top.setSeries(models.length + 1 + i, { show: on });
        if (i < picked) { reveal(channel.names[models.length + i], on); }
      });
    });
    picks.hidden = false;
    figure.querySelector(".picks").hidden = false;
    figure.querySelector(".save").addEventListener("click", function () {
      var names = ["time_s", "measured"].concat(channel.models, channel.others, channel.titles[2]);
      var columns = [current.t, current.y].concat(current.models, others, [current.u]);
      save(current.label + ".csv", [names.map(quoted)].concat(current.t.map(function (_, row) {
        return columns.map(function (column) { return column[row]; });
      })));
    });
    return show;
  }

  function ownColour(i) { return i === 0 ? "arx" : "ts"; }

  function otherColour(i) { return "r" + (8 - i % 8); }

  function spread(values, n) { // one number stands for equal ones
    return values.length === 1 && n > 1 ? new Array(n).fill(values[0]) : values;
  }

  function quoted(text) { return '"' + text.replace(/"/g, '""') + '"'; }

  function press(parent, name, css, down, act) { // a button that stays down
    var button = document.createElement("button");
    var swatch = document.createElement("span");
    button.type = "button";
    button.setAttribute("aria-pressed", String(down));
    swatch.className = "swatch " + css;
    swatch.setAttribute("aria-hidden", "true");
    button.append(swatch, name);
    button.addEventListener("click", function () {
      var on = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", String(on));
      act(on);
    });
    parent.appendChild(button);
  }

  function save(name, rows) {
    var link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([rows.join("\n") + "\n"], { type: "text/csv" }));
    link.download = name.replace(/[^\w.-]+/g, "-");
    link.click();
    setTimeout(function () { URL.revokeObjectURL(link.href); }, 1000);
  }

  function start(figure) {
    if (figure.dataset.started) { return; }
    figure.dataset.started = "yes";
    var index = +figure.dataset.index, channel = data(index);
    var show = draw(figure, channel, index);
    figure.querySelectorAll(".scripted").forEach(function (e) { e.hidden = false; });
    var group = document.querySelector('.segments[data-index="' + index + '"]');
    group.hidden = false;
    var buttons = Array.prototype.slice.call(group.querySelectorAll("button"));
    buttons.forEach(function (button, i) {
      button.setAttribute("aria-pressed", i === channel.shown ? "true" : "false");
      button.addEventListener("click", function () {
        buttons.forEach(function (b) { b.setAttribute("aria-pressed", b === button ? "true" : "false"); });
        show(i);
      });
    });
  }

  function resize() {
    charts.forEach(function (c) {
      if (c.plot && c.parent.clientWidth > 0) { c.plot.setSize({ width: Math.max(260, c.parent.clientWidth), height: c.height }); }
      if (c.paint) { c.paint(); }
    });
  }

  function repaint() {
    charts.forEach(function (c) { if (c.plot) { c.plot.redraw(false, true); } if (c.paint) { c.paint(); } });
  }

  var waits = "IntersectionObserver" in window ? new IntersectionObserver(function (entries) {
    entries.forEach(function (entry) {
      if (entry.isIntersecting) {
        waits.unobserve(entry.target);
        start(entry.target);
      }
    });
  }, { rootMargin: "400px" }) : null;

  function startWhenSeen(figure) { // until then its still picture stands there
    if (waits) { waits.observe(figure); } else { start(figure); }
  }

  var sections = Array.prototype.slice.call(document.querySelectorAll(".channel"));
  var tabs = document.getElementById("tabs");
  function open(section) {
    sections.forEach(function (s) { s.hidden = s !== section; });
    tabs.querySelectorAll("button").forEach(function (b) {
      var on = b.getAttribute("aria-controls") === section.id;
      b.setAttribute("aria-selected", on ? "true" : "false");
      b.tabIndex = on ? 0 : -1;
    });
    section.querySelectorAll(".overlay").forEach(startWhenSeen);
    resize();
  }
  if (sections.length > 1) {
    tabs.hidden = false;
    tabs.setAttribute("role", "tablist");
    tabs.setAttribute("aria-label", "Channels");
    sections.forEach(function (section, i) {
      var tab = document.createElement("button");
      tab.type = "button";
      tab.setAttribute("role", "tab");
      tab.id = section.id + "-tab";
      tab.setAttribute("aria-controls", section.id);
      tab.textContent = section.querySelector("h2").textContent;
      tab.addEventListener("click", function () { open(section); });
      tab.addEventListener("keydown", function (event) {
        var step = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0;
        if (step) {
          var next = (i + step + sections.length) % sections.length;
          open(sections[next]);
          tabs.children[next].focus();
        }
      });
      section.setAttribute("role", "tabpanel");
      tabs.appendChild(tab);
    });
  }
  if (sections.length) { open(sections[0]); }

  var theme = document.getElementById("theme");
  theme.hidden = false;
  theme.addEventListener("click", function () {
    var dark = root.dataset.theme ? root.dataset.theme === "dark" : window.matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
    repaint();
  });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
  var waiting = 0;
  window.addEventListener("resize", function () {
    clearTimeout(waiting);
    waiting = setTimeout(resize, 120);
  });
  requestAnimationFrame(function () { // the first screen is painted: now lay out what is below it
    setTimeout(function () { root.dataset.ready = "yes"; }, 0);
  });
})();
