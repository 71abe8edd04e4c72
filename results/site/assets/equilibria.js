// Equilibria along a parameter: a plot on which one is picked, its numbers and its eigenvalues beside it.
(function () {
  "use strict";
  var it = orbitfinder.data.equilibria, plots = orbitfinder.plots, figure = orbitfinder.figure, picked = -1;
  function part(id) { return document.getElementById(id); }
  function safe(text) { return String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;"); }
  var plot = part("plot"), slider = part("item"), GROWTH = -2, PARAMETER = -1;
  var SYMBOLS = { hopf: "circle", fold: "square", branch_point: "diamond", neutral_saddle: "x" };
  var file = "equilibria/" + it.name + "/equilibria.json";

  // Points and events in order along the curve, and its stretches of one stability, which meet at both ends.
  it.points.forEach(function (one) { one.key = "point=" + one.number; one.words = one.stability; });
  it.events.forEach(function (one, k) { one.key = "event=" + k; one.number = k; one.value = one.parameter; one.words = one.words.replace("hopf", "Hopf point"); });
  var items = it.points.concat(it.events).sort(function (a, b) { return a.arclength - b.arclength; }), stretches = [];
  items.slice(1).forEach(function (one, k) {
    var last = stretches[stretches.length - 1], known = [one, items[k]].find(function (each) { return each.stability; });
    var stable = !!known && known.stability !== "unstable";
    if (last && last.stable === stable) last.run.push(one); else stretches.push({ stable: stable, run: [items[k], one] });
  });
  orbitfinder.picked = function () { return items[picked]; };

  function number(one, name) {
    return name === PARAMETER ? one.value : name === GROWTH ? one.eigenvalues.length ? one.eigenvalues[0][0] : null : one.state[name];
  }
  function title(name) { return name === PARAMETER ? safe(it.parameter) : name === GROWTH ? "real parts of the eigenvalues" : it.labels[name]; }
  function axes() { return { x: +part("across").value, y: +part("up").value }; }
  function label(one) {
    return safe(one.words) + "<br>" + safe(it.parameter) + " " + figure(one.value, 7);
  }
  function marks(which, chosen, look) {
    return Object.assign({ x: which.map(function (k) { return number(items[k], chosen.x); }),
      y: which.map(function (k) { return number(items[k], chosen.y); }), customdata: which, mode: "markers",
      text: which.map(function (k) { return label(items[k]); }), hovertemplate: "%{text}<extra></extra>" }, look);
  }
  function where(test) { return items.map(function (_, k) { return k; }).filter(function (k) { return test(items[k]); }); }

  // The curve in stretches of one stability, which meet where it changes.
  function curve(chosen, c) {
    var named = {};
    return stretches.map(function (one) {
      var kind = one.stable ? "stable" : "unstable", first = !named[kind];
      named[kind] = true;
      return { x: one.run.map(function (each) { return number(each, chosen.x); }), y: one.run.map(function (each) { return number(each, chosen.y); }),
        mode: "lines", hoverinfo: "skip", name: kind, legendgroup: kind, showlegend: first,
        line: { color: c.series[0], width: one.stable ? 2.6 : 1.6, dash: one.stable ? "solid" : "dash" } };
    });
  }

  // The real parts of all eigenvalues; one that crosses 0 changes the stability.
  function growth(chosen, c) {
    var x = [], y = [], which = [];
    items.forEach(function (one, k) {
      one.eigenvalues.forEach(function (pair) { x.push(number(one, chosen.x)); y.push(pair[0]); which.push(k); });
    });
    return [{ x: x, y: y, customdata: which, mode: "markers", name: "eigenvalues", showlegend: false, text: which.map(function (k) { return label(items[k]); }),
      hovertemplate: "%{text}<extra></extra>", marker: { size: 4, color: c.series[0] } }];
  }

  // The cycles that are born here: the least and the largest of a component; a click opens one on its family's page.
  function cycles(chosen, c) {
    var traces = [], named = false;
    it.cycles.forEach(function (family) {
      [family.low, family.high].forEach(function (side) {
        for (var k = 0, from = 0; k <= side.length; k++) {
          var stable = from < side.length && family.places[from][2] !== "unstable";
          if (k < side.length && (family.places[k][2] !== "unstable") === stable) continue;
          var start = Math.max(0, from - 1), run = family.places.slice(start, k);
          traces.push({ x: run.map(function (one) { return one[0]; }), y: side.slice(start, k).map(function (one) { return one && one[chosen.y]; }),
            customdata: run.map(function (one) { return one[1]; }), mode: "lines+markers", name: "cycles, least and largest", legendgroup: "cycles", showlegend: !named,
            text: run.map(function (one) { return safe(family.name) + "<br>" + safe(it.parameter) + " " + figure(one[0], 7) + "<br>" + safe(one[2]); }),
            hovertemplate: "%{text}<extra></extra>", marker: { size: stable ? 4 : 3.5, color: stable ? c.series[2] : c.surface, line: { width: stable ? 0 : 1, color: c.series[2] } },
            line: { color: c.series[2], width: stable ? 2.6 : 1.4, dash: stable ? "solid" : "dash" } });
          named = true;
          from = k;
        }
      });
    });
    return traces;
  }

  function events(chosen, c) {
    return Object.keys(SYMBOLS).concat(["other"]).map(function (kind) {
      var which = where(function (one) { return one.kind && (one.kind === kind || kind === "other" && !(one.kind in SYMBOLS)); });
      return marks(which, chosen, { name: kind === "hopf" ? "Hopf point" : kind.replace(/_/g, " "), showlegend: which.length > 0, visible: which.length > 0,
        marker: { symbol: SYMBOLS[kind] || "star", size: 11, color: c.series[1], line: { color: c.surface, width: 1 } } });
    });
  }

  plots.plot(plot, function () {
    var chosen = axes(), c = orbitfinder.colours(), many = chosen.y === GROWTH, traces = many ? growth(chosen, c) : curve(chosen, c);
    if (!many) [true, false].forEach(function (stable) {
      traces.push(marks(where(function (one) { return !one.kind && (one.words !== "unstable") === stable; }), chosen,
        { showlegend: false, marker: { size: stable ? 6 : 5, color: stable ? c.series[0] : c.surface, line: { width: stable ? 0 : 1.3, color: c.series[0] } } }));
    });
    if (chosen.x === PARAMETER && chosen.y >= 0) traces = cycles(chosen, c).concat(traces);
    traces = traces.concat(events(chosen, c));
    if (picked >= 0) {
      var x = number(items[picked], chosen.x), own = many ? items[picked].eigenvalues.map(function (pair) { return pair[0]; }) : [number(items[picked], chosen.y)];
      traces.push({ x: own.map(function () { return x; }), y: own, mode: "markers", hoverinfo: "skip", showlegend: false,
        marker: { size: 18, symbol: "circle-open", color: c.ink, line: { width: 2.2 } } });
    }
    return { traces: traces, layout: plots.layout(plots.axis(title(chosen.x), { zeroline: false, fixedrange: false }),
      plots.axis(title(chosen.y), { zeroline: many, zerolinecolor: c.muted, fixedrange: false }),
      { uirevision: [chosen.x, chosen.y].join(), showlegend: true, dragmode: plots.drag,
        legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, margin: { l: 64, r: 16, t: 60, b: 48 } }) };
  });

  plots.plot(part("plane"), function () {
    var c = orbitfinder.colours(), pairs = picked < 0 ? [] : items[picked].eigenvalues;
    var size = pairs.reduce(function (most, pair) { return Math.max(most, Math.hypot(pair[0], pair[1])); }, 0) || 1;
    function half(m) { return 1.25 * pairs.reduce(function (most, pair) { return Math.max(most, Math.abs(pair[m])); }, size / 10); } // round-off is no axis
    function side(right) {
      var some = pairs.filter(function (pair) { return (pair[0] > 0) === right; });
      return { x: some.map(function (pair) { return pair[0]; }), y: some.map(function (pair) { return pair[1]; }), mode: "markers", cliponaxis: false,
        hovertemplate: "%{x:.6g}, %{y:.6g} i<extra></extra>",
        marker: { size: 10, symbol: right ? "diamond" : "circle", color: c.series[right ? 1 : 0], line: { color: c.surface, width: 1 } } };
    }
    return { traces: [side(false), side(true)], layout: plots.layout(
      plots.axis("real part", { range: [-half(0), half(0)], zeroline: true, zerolinecolor: c.muted, zerolinewidth: 2, nticks: 5 }),
      plots.axis("imaginary part", { range: [-half(1), half(1)], zeroline: true, nticks: 5 })) };
  });

  function told(one) {
    var facts = [[it.parameter, figure(one.value, 12)]].concat(it.names.slice(0, 12).map(function (name, k) { return [name, figure(one.state[k], 9)]; }));
    if (it.names.length > 12) facts.push(["More components", it.names.length - 12 + ", in the file"]);
    if (!one.kind) return facts.concat([["Stability", one.stability], ["By other equations", (one.certified ? "certified" : "not certified") + ", rates " + figure(one.residual || 0, 2)]]);
    if (one.period) facts.push(["Period", figure(one.period, 10)], ["First Lyapunov coefficient", figure(one.lyapunov, 6)]);
    if (one.check) facts.push(["By the flow", one.check.passed ? "certified" : "not certified"]);
    return [["Event", one.words]].concat(facts, [["Error bar of " + it.parameter, figure(one.error, 2)]]);
  }
  function command(one) {
    if (!one.kind) return "orbitfinder verify " + file + "#" + one.number;
    return one.direction && one.direction.length ? "orbitfinder continue " + file + " --switch " + one.number : "";
  }

  function row(cells, name) {
    var line = document.createElement(name ? "div" : "tr");
    cells.forEach(function (text, k) {
      var cell = document.createElement(name ? ["dt", "dd"][k] : "td");
      cell.textContent = text;
      line.append(cell);
    });
    return line;
  }

  function pick(k) {
    if (k === picked || k < 0 || k >= items.length) return;
    var one = items[k];
    picked = k;
    part("picked").replaceChildren.apply(part("picked"), told(one).map(function (cells) { return row(cells, true); }));
    part("eigenvalues").replaceChildren.apply(part("eigenvalues"), one.eigenvalues.slice(0, 24).map(function (pair) {
      return row([figure(pair[0], 8), figure(pair[1], 8)]); }));
    part("command").textContent = command(one);
    part("command-box").hidden = !command(one);
    slider.value = k;
    part("item-text").textContent = (k + 1) + " of " + items.length;
    slider.setAttribute("aria-valuetext", one.words + ", " + it.parameter + " " + figure(one.value, 7));
    plots.redraw(plot);
    plots.redraw(part("plane"));
  }

  var picker = plots.picker(plot, { items: items, pick: pick, picked: function () { return picked; },
    place: function (k) { var chosen = axes(); return [number(items[k], chosen.x), number(items[k], chosen.y)]; } });
  plot.on("plotly_click", function (event) { if (typeof event.points[0].customdata === "string") location.href = event.points[0].customdata; });
  function step(to) { pick(to); picker.address(false); }
  slider.max = Math.max(0, items.length - 1);
  slider.addEventListener("input", function () { step(+slider.value); });
  part("previous").addEventListener("click", function () { step(picked - 1); });
  part("next").addEventListener("click", function () { step(picked + 1); });
  ["across", "up"].forEach(function (id) { part(id).addEventListener("change", function () { plots.redraw(plot); }); });
  document.querySelectorAll(".pick").forEach(function (button) {
    button.addEventListener("click", function () {
      pick(items.findIndex(function (one) { return one.key === "event=" + button.dataset.event; }));
      picker.lock(true);
      picker.address(true);
      plot.scrollIntoView({ block: "center", behavior: orbitfinder.calm ? "auto" : "smooth" });
    });
  });
  part("save-csv").addEventListener("click", function () {
    function quoted(text) { return '"' + String(text).replace(/"/g, '""') + '"'; }
    var rows = [["kind", quoted(it.parameter)].concat(it.names.map(quoted), "stability").join(",")];
    items.forEach(function (one) {
      rows.push([one.kind || "point", one.value].concat(one.state, one.kind ? "" : quoted(one.words)).join(","));
    });
    orbitfinder.save(it.name.replace(/[^A-Za-z0-9_.-]+/g, "-") + ".csv", "text/csv", rows.join("\n") + "\n");
  });
  pick(0);
  picker.open();
  addEventListener("pageshow", function () { plots.redraw(plot); });
})();
