(function () {
  "use strict";
  var root = document.documentElement;
  var flights = JSON.parse(document.getElementById("data").textContent);
  var COLOURS = ["r6", "arx", "r2", "r5", "r1", "r3", "r7", "r8"];

  function colour(name) {
    return getComputedStyle(root).getPropertyValue("--" + name).trim();
  }

  function numbers(text) { // base64 of little-endian float64
    var raw = atob(text), bytes = new Uint8Array(raw.length);
    for (var i = 0; i < raw.length; i++) { bytes[i] = raw.charCodeAt(i); }
    return new Float64Array(bytes.buffer);
  }

  function first(times, at) { // index of the first time that is not before `at`
    var low = 0, high = times.length;
    while (low < high) {
      var middle = (low + high) >> 1;
      if (times[middle] < at) { low = middle + 1; } else { high = middle; }
    }
    return low;
  }

  function plain(value) {
    return String(+value.toPrecision(6)).replace("-", "\u2212");
  }

  // What a view of [from, to] draws of a trace: all samples, or the extremes of each column of pixels.
  function visible(trace, from, to, columns) {
    var a = Math.max(0, first(trace.t, from) - 1), b = Math.min(trace.t.length, first(trace.t, to) + 1);
    var t = [], v = [], i;
    if (b - a <= 2 * columns) {
      for (i = a; i < b; i++) { t.push(trace.t[i]); v.push(isNaN(trace.v[i]) ? null : trace.v[i]); }
      return [t, v];
    }
    var size = (b - a) / columns, last = -Infinity;
    function add(k, value) {
      var at = trace.t[k];
      if (at <= last) { at = last + 1e-9; } // times of one table must rise
      last = at;
      t.push(at);
      v.push(value);
    }
    for (var c = 0; c < columns; c++) {
      var start = Math.floor(a + c * size), end = Math.min(b, Math.floor(a + (c + 1) * size));
      var low = -1, high = -1, gap = -1;
      for (i = start; i < end; i++) {
        if (isNaN(trace.v[i])) { gap = i; continue; }
        if (low < 0 || trace.v[i] < trace.v[low]) { low = i; }
        if (high < 0 || trace.v[i] > trace.v[high]) { high = i; }
      }
      [low, high, gap].filter(function (k, n, all) { return k >= 0 && all.indexOf(k) === n; })
        .sort(function (x, y) { return x - y; })
        .forEach(function (k) { add(k, k === gap ? null : trace.v[k]); });
    }
    return [t, v];
  }

  function value(trace, at) { // the latest sample, unless a gap follows it
    var i = first(trace.t, at + 1e-12) - 1;
    return i < 0 || isNaN(trace.v[i]) ? null : trace.v[i];
  }

  function show(section) {
    var flight = flights[+section.dataset.index];
    var parent = section.querySelector(".panels"), reading = section.querySelector(".reading");
    var panels = flight.panels.map(function (traces) {
      return traces.map(function (trace) {
        return { name: trace.name, unit: trace.unit, t: numbers(trace.t), v: numbers(trace.v) };
      });
    });
    var end = 0;
    panels.forEach(function (traces) {
      traces.forEach(function (trace) { if (trace.t.length) { end = Math.max(end, trace.t[trace.t.length - 1]); } });
    });
    end = end || 1;
    var view = { min: 0, max: end }, plots = [], settling = false;

    function behind(plot) { // flight modes as bands, events as ticks
      var pen = plot.ctx, box = plot.bbox, ratio = window.devicePixelRatio || 1;
      pen.save();
      pen.beginPath();
      pen.rect(box.left, box.top, box.width, box.height);
      pen.clip();
      pen.textAlign = "left";
      pen.textBaseline = "alphabetic";
      pen.font = 11 * ratio + "px system-ui";
      flight.modes.forEach(function (mode, i) {
        var a = plot.valToPos(mode[0], "x", true), b = plot.valToPos(mode[1], "x", true);
        if (i % 2 === 0) { pen.fillStyle = colour("grid"); pen.fillRect(a, box.top, b - a, box.height); }
        if (plot === plots[0] && b - a > pen.measureText(mode[2]).width + 8 * ratio) {
          pen.fillStyle = colour("dim");
          pen.fillText(mode[2], Math.max(a, box.left) + 4 * ratio, box.top + 13 * ratio);
        }
      });
      flight.moments.forEach(function (moment) {
        var at = Math.round(plot.valToPos(moment[0], "x", true));
        pen.fillStyle = colour(moment[1] === "parameter" ? "arx" : "r5");
        pen.fillRect(at, box.top, ratio, 7 * ratio);
      });
      pen.restore();
    }

    function tell(plot) {
      var left = plot.cursor.left;
      reading.textContent = "";
      if (left === null || left < 0) { return; }
      var at = plot.posToVal(left, "x"), reach = plot.posToVal(left + 6, "x") - at;
      add(plain(at) + " s", "");
      flight.modes.forEach(function (mode) { if (mode[0] <= at && at < mode[1]) { add(mode[2], ""); } });
      panels.forEach(function (traces) {
        traces.forEach(function (trace) {
          var seen = value(trace, at);
          add(seen === null ? "\u2013" : plain(seen) + (trace.unit ? " " + trace.unit : ""), trace.name);
        });
      });
      flight.moments.filter(function (moment) { return Math.abs(moment[0] - at) < reach; }).slice(0, 3)
        .forEach(function (moment) { add(moment[2], ""); });

      function add(text, label) {
        var span = document.createElement("span"), strong = document.createElement("b");
        span.textContent = label ? label + " " : "";
        strong.textContent = text;
        span.appendChild(strong);
        reading.appendChild(span);
      }
    }

    function redraw() {
      settling = true;
      plots.forEach(function (plot, i) {
        var columns = Math.max(200, Math.round(plot.bbox.width));
        plot.batch(function () {
          plot.setData(uPlot.join(panels[i].map(function (trace) {
            return visible(trace, view.min, view.max, columns);
          })), false);
          plot.setScale("x", { min: view.min, max: view.max });
          plot.setScale("y", { min: null, max: null });
        });
      });
      settling = false;
      section.dataset.from = view.min;
      section.dataset.to = view.max;
    }

    function look(min, max) {
      var span = Math.min(Math.max(max - min, 1e-3), end);
      min = Math.min(Math.max(min, 0), end - span);
      view = { min: min, max: min + span };
      redraw();
    }

    function extent(traces) { // lowest and highest value in view, with a margin
      var low = Infinity, high = -Infinity;
      traces.forEach(function (trace) {
        var a = first(trace.t, view.min), b = first(trace.t, view.max + 1e-12);
        for (var i = a; i < b; i++) {
          var x = trace.v[i];
          if (x < low) { low = x; }
          if (x > high) { high = x; }
        }
      });
      if (low > high) { return [0, 1]; }
      var margin = 0.06 * (high - low) || 0.06 * Math.abs(high) || 1;
      return [low - margin, high + margin];
    }

    panels.forEach(function (traces, index) {
      var box = document.createElement("div"), key = document.createElement("ul");
      box.className = "chart";
      key.dataset.fields = traces.map(function (trace) { return trace.name; }).join(" ");
      box.tabIndex = 0;
      box.setAttribute("role", "img");
      box.setAttribute("aria-label", traces.map(function (trace) { return trace.name; }).join(", ") + " over time");
      key.className = "key";
      traces.forEach(function (trace, i) {
        var item = document.createElement("li"), line = document.createElement("span");
        line.className = "line";
        line.style.borderColor = "var(--" + COLOURS[i % COLOURS.length] + ")";
        item.appendChild(line);
        item.appendChild(document.createTextNode(trace.name + (trace.unit ? ", " + trace.unit : "")));
        key.appendChild(item);
      });
      parent.appendChild(key);
      parent.appendChild(box);
      var ink = function () { return colour("dim"); };
      var grid = { stroke: function () { return colour("grid"); }, width: 1 };
      var lowest = index === panels.length - 1;
      plots.push(new uPlot({
        width: Math.max(260, parent.clientWidth - 16),
        height: lowest ? 186 : 160,
        legend: { show: false },
        cursor: { sync: { key: "flight" + section.dataset.index }, drag: { x: true, y: false } },
        scales: { x: { time: false }, y: { range: function () { return extent(traces); } } },
        axes: [
          { stroke: ink, grid: grid, ticks: { show: false }, size: lowest ? 40 : 8, font: "11px system-ui", labelFont: "11px system-ui", labelSize: 16, label: lowest ? "time, s" : undefined, values: lowest ? undefined : function (u, v) { return v.map(function () { return ""; }); } },
          { stroke: ink, grid: grid, ticks: { show: false }, size: 60, font: "11px system-ui", values: function (u, v) { return v.map(plain); } }
        ],
        series: [{}].concat(traces.map(function (trace, i) {
          return { label: trace.name, stroke: function () { return colour(COLOURS[i % COLOURS.length]); }, width: 1.3, points: { show: false } };
        })),
        hooks: {
          drawClear: [behind],
          setCursor: [function (plot) { if (plot.cursor.event) { tell(plot); } }],
          setSelect: [function (plot) {
            if (plot.select.width > 3) {
              look(plot.posToVal(plot.select.left, "x"), plot.posToVal(plot.select.left + plot.select.width, "x"));
            }
          }],
          setScale: [function (plot, scale) {
            if (scale === "x" && !settling) { settling = true; view = { min: plot.scales.x.min, max: plot.scales.x.max }; settling = false; }
          }]
        }
      }, [[0]].concat(traces.map(function () { return [null]; })), box));
      var plot = plots[index];
      plot.over.addEventListener("dblclick", function () { look(0, end); });
      plot.over.addEventListener("wheel", function (event) {
        event.preventDefault();
        var at = plot.posToVal(event.offsetX, "x"), factor = event.deltaY < 0 ? 0.75 : 1 / 0.75;
        look(at - (at - view.min) * factor, at + (view.max - at) * factor);
      }, { passive: false });
      box.addEventListener("keydown", function (event) {
        var moves = { ArrowLeft: [-0.2, -0.2], ArrowRight: [0.2, 0.2], "+": [0.25, -0.25], "=": [0.25, -0.25], "-": [-0.5, 0.5] };
        var move = moves[event.key], span = view.max - view.min;
        if (event.ctrlKey || event.metaKey || event.altKey || (!move && event.key !== "0")) { return; }
        event.preventDefault();
        if (move) { look(view.min + move[0] * span, view.max + move[1] * span); } else { look(0, end); }
      });
    });
    var others = document.querySelectorAll('.go[data-flight="' + section.dataset.index + '"]');
    Array.from(section.querySelectorAll(".go")).concat(Array.from(others)).forEach(function (button) {
      button.addEventListener("click", function () {
        var at = +button.dataset.at, half = Math.min(end, 10) / 2;
        if (button.dataset.at) { look(at - half, at + half); } else { look(0, end); }
        (parent.querySelector('[data-fields~="' + button.dataset.field + '"]') || section).scrollIntoView();
      });
    });
    look(0, end);
    window.addEventListener("resize", function () {
      plots.forEach(function (plot) { plot.setSize({ width: Math.max(260, parent.clientWidth - 16), height: plot.height }); });
      redraw();
    });
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  }

  document.querySelectorAll(".flight").forEach(show);
  root.dataset.ready = "yes";
})();
