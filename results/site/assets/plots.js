// What all plots share: the look, in either theme, and marks that follow the motion without redrawing.
orbitfinder.plots = (function () {
  "use strict";
  var drawn = [];
  var config = { responsive: true, displaylogo: false, displayModeBar: false, scrollZoom: false };

  function axis(title, more) {
    var c = orbitfinder.colours();
    return Object.assign({ title: { text: title, standoff: 8 }, gridcolor: c.line, zerolinecolor: c.line, linecolor: c.line,
      tickcolor: c.line, automargin: true, fixedrange: true, nticks: 6, exponentformat: "power" }, more || {});
  }

  function layout(across, up, more) {
    var c = orbitfinder.colours();
    return Object.assign({ paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false,
      font: { family: "system-ui, sans-serif", size: 13, color: c.ink }, margin: { l: 56, r: 14, t: 12, b: 44 },
      hoverlabel: { bgcolor: c.surface, bordercolor: c.muted, font: { color: c.ink } },
      xaxis: across, yaxis: up, hovermode: "closest" }, more || {});
  }

  // `make` returns { traces, layout } in the colours of the moment; it is asked again when the theme changes.
  // Lines are drawn through every sample: thinning them puts corners into smooth curves.
  function plot(div, given) {
    function make() {
      var made = given();
      made.traces.forEach(function (trace) { if (trace.line) trace.line = Object.assign({ simplify: false }, trace.line); });
      return made;
    }
    var made = make();
    Plotly.newPlot(div, made.traces, made.layout, config);
    drawn.push({ div: div, make: make });
  }

  // With `anew` whatever was zoomed is shown whole again.
  function redraw(div, anew) {
    drawn.forEach(function (one) {
      if (div && one.div !== div) return;
      var made = one.make();
      if (anew) made.layout.uirevision = Math.random();
      Plotly.react(one.div, made.traces, made.layout, config);
    });
  }
  document.addEventListener("orbitfinder-theme", function () { redraw(null); });

  // A dot (or, without y, an upright line) over a plot, moved by a transform.
  function Mark(div, kind) {
    this.div = div;
    this.node = document.createElement("div");
    this.node.className = "mark " + kind;
    this.node.setAttribute("aria-hidden", "true");
    div.appendChild(this.node);
  }
  Mark.prototype.move = function (x, y) {
    var full = this.div._fullLayout, across = full.xaxis, up = full.yaxis, line = y === undefined;
    var left = across._offset + across.l2p(across.d2l(x)), top = line ? up._offset : up._offset + up.l2p(up.d2l(y));
    if (line) this.node.style.height = up._length + "px";
    this.node.style.transform = "translate(" + left.toFixed(1) + "px," + top.toFixed(1) + "px)";
  };

  var LIMIT = 2;
  // Multipliers and the unit circle; those farther out than LIMIT sit at the rim, named with their size.
  function circle(pairs) {
    var c = orbitfinder.colours(), x = [], y = [], inside = { x: [], y: [], text: [] }, outside = { x: [], y: [], text: [] };
    for (var k = 0; k <= 180; k++) { x.push(Math.cos(k * Math.PI / 90)); y.push(Math.sin(k * Math.PI / 90)); }
    (pairs || []).forEach(function (pair) {
      var size = Math.hypot(pair[0], pair[1]), sign = pair[1] < 0 ? " \u2212 " : " + ";
      if (size <= LIMIT) {
        inside.x.push(pair[0]);
        inside.y.push(pair[1]);
        inside.text.push(orbitfinder.figure(pair[0], 5) + sign + orbitfinder.figure(Math.abs(pair[1]), 5) + "i");
        return;
      }
      var x = pair[0] * LIMIT / size, y = pair[1] * LIMIT / size, same = outside.x.findIndex(function (u, i) {
        return Math.hypot(u - x, outside.y[i] - y) < 0.3; });
      if (same >= 0) { outside.text[same] += "<br>" + orbitfinder.figure(size, 3); return; }
      outside.x.push(x);
      outside.y.push(y);
      outside.text.push("|\u03bc| = " + orbitfinder.figure(size, 3));
    });
    var traces = [
      { x: x, y: y, mode: "lines", line: { color: c.muted, width: 1 }, hoverinfo: "skip" },
      { x: inside.x, y: inside.y, text: inside.text, mode: "markers", hoverinfo: "text",
        marker: { size: 10, color: c.series[0], line: { color: c.surface, width: 1 } } },
      { x: outside.x, y: outside.y, text: outside.text, mode: "markers+text", hoverinfo: "text", textposition: "bottom center",
        textfont: { color: c.ink, size: 12 }, cliponaxis: false,
        marker: { size: 12, symbol: "triangle-up", color: c.series[1], angle: outside.x.map(function (u, i) {
          return 90 - Math.atan2(outside.y[i], u) * 180 / Math.PI; }) } }];
    var edge = LIMIT + 0.6;
    return { traces: traces, layout: layout(axis("real part", { range: [-edge, edge], dtick: 1, zeroline: true }),
      axis("imaginary part", { range: [-edge, edge], dtick: 1, scaleanchor: "x", zeroline: true })) };
  }

  // What is picked from a plot: by the pointer until a click or the button holds it, and by the address of the page,
  // which gets a new entry in the browser's history by a click. `on` has items with a key each, pick(k), picked(),
  // place(k) and maybe more(), what else the address says, with read(text) to take it in.
  function picker(plot, on) {
    var held = false, writing = null;
    function part(id) { return document.getElementById(id); }
    function lock(now) {
      held = now;
      part("lock").setAttribute("aria-pressed", String(now));
      part("lock").textContent = now ? "Held" : "Hold";
    }
    function address(anew) {
      clearTimeout(writing);
      function write() {
        if (on.picked() < 0) return;
        var wanted = "#" + encodeURI(on.items[on.picked()].key) + (on.more ? on.more() : "");
        if (location.hash === wanted) return;
        if (anew) location.hash = wanted; else location.replace(wanted);
      }
      if (anew) write(); else writing = setTimeout(write, 250);
    }
    function open() {
      var parts = decodeURIComponent(location.hash.slice(1)).split("&with="), find = function (wanted) {
        return on.items.findIndex(function (one) { return one.key === wanted; }); };
      if (find(parts[0]) < 0) return;
      lock(true);
      on.pick(find(parts[0]));
      if (on.read) on.read(parts.length > 1 ? find(parts[1]) : -1);
    }
    function near() {
      if (on.picked() < 0) return;
      var full = plot._fullLayout, change = {}, place = on.place(on.picked());
      [full.xaxis, full.yaxis].forEach(function (axis, k) {
        var at = axis.d2l(place[k]), half = (axis.range[1] - axis.range[0]) / 6;
        if (isFinite(at)) change[axis._name + ".range"] = [at - half, at + half];
      });
      Plotly.relayout(plot, change);
    }
    addEventListener("hashchange", function () { clearTimeout(writing); open(); });
    addEventListener("keydown", function (event) { if (event.key === "Escape") lock(false); });
    part("lock").addEventListener("click", function () { lock(!held); address(false); });
    part("near").addEventListener("click", near);
    part("whole").addEventListener("click", function () { redraw(plot, true); });
    function number(event) { var k = event.points[0].customdata; return typeof k === "number" ? k : -1; }
    plot.on("plotly_click", function (event) { if (number(event) >= 0) { on.pick(number(event)); lock(true); address(true); } });
    plot.on("plotly_hover", function (event) { if (number(event) >= 0 && !held) { on.pick(number(event)); address(false); } });
    return { lock: lock, address: address, open: open };
  }
  var drag = matchMedia("(pointer: coarse)").matches ? false : "zoom";

  return { plot: plot, redraw: redraw, axis: axis, layout: layout, Mark: Mark, circle: circle, picker: picker, drag: drag };
})();
