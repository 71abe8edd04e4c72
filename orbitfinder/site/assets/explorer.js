// Families and atlases: a plot on which an orbit is picked, and the picked orbit moving beside it.
(function () {
  "use strict";
  var it = orbitfinder.data.explorer, plots = orbitfinder.plots, player = new orbitfinder.Player();
  var family = it.page === "family", figure = orbitfinder.figure, items = it.items, shown = [], picked = -1;
  orbitfinder.player = player;
  orbitfinder.picked = function () { return items[picked]; };
  function part(id) { return document.getElementById(id); }
  var plot = part("plot"), slider = part("item"), scene = player.add(part("stage"), null);
  player.controls();
  player.scrubber(function () { return picked < 0 ? 0 : items[picked].period; });

  var NAMES = { energy: "energy, J", frequency: "frequency, 1/s", period: "period, s", action: "action, J s",
    amplitude: (it.curve ? "" : "amplitude of ") + safe(it.moved || ""), largest: "largest multiplier", value: safe(it.parameter) };
  var SYMBOLS = { fold: "triangle-down", branch_point: "circle-open", period_doubling: "square", torus: "cross", resonance: "circle",
    collision: "x", stability_change: "diamond", cusp: "triangle-up", strong_resonance: "pentagon", isola_centre: "hexagon" };

  function axes() { return { x: part("across").value, y: part("up").value }; }
  function alike(name) {
    var all = items.map(function (one) { return number(one, name); }), most = Math.max.apply(null, all);
    return most - Math.min.apply(null, all) < 1e-6 * Math.max(Math.abs(most), 1e-12);
  }
  if (!family && items.length > 1 && alike("energy")) part("across").value = "action"; // a search at one energy
  function number(one, name) {
    if (name === "frequency") return 1 / one.period;
    if (name !== "largest") return one[name];
    if (one.largest !== undefined) return one.largest;
    if (!one.multipliers) return null;
    return one.multipliers.reduce(function (most, pair) { return Math.max(most, Math.hypot(pair[0], pair[1])); }, 1);
  }
  function column(name) {
    var c = it.columns;
    return name === "frequency" ? c.period.map(function (T) { return 1 / T; }) : c[name];
  }
  function scale(name) {
    if (name === "largest") return { type: "log" };
    if (!items.length || !alike(name)) return {};
    var one = number(items[0], name), room = Math.max(0.05 * Math.abs(one), 1e-6);
    return { range: [one - room, one + room] };
  }

  // The curve in runs of one stability each, joined to the next: solid where stable, dashed where not.
  function curve(chosen, colour) {
    var x = column(chosen.x), y = column(chosen.y), stable = it.columns.stable, traces = [], named = {};
    for (var k = 0, from = 0; k <= x.length; k++) {
      if (k < x.length && stable[k] === stable[from]) continue;
      var start = Math.max(0, from - 1), kind = stable[from] ? "stable" : "unstable";
      traces.push({ x: x.slice(start, k), y: y.slice(start, k), mode: "lines", hoverinfo: "skip", name: kind, legendgroup: kind,
        showlegend: !named[kind], line: { color: colour, width: stable[from] ? 2.6 : 1.6, dash: stable[from] ? "solid" : "dash" } });
      named[kind] = true;
      from = k;
    }
    return traces;
  }

  function points(chosen, which, look) {
    return Object.assign({ x: which.map(function (k) { return number(items[k], chosen.x); }),
      y: which.map(function (k) { return number(items[k], chosen.y); }), customdata: which, mode: "markers",
      text: which.map(label), hovertemplate: "%{text}<extra></extra>" }, look);
  }
  function safe(text) { return String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;"); }
  function label(k) {
    var one = items[k];
    return (one.event ? safe(one.event) + "<br>" : one.title ? safe(one.title) + "<br>" : "") +
      "energy " + figure(one.energy, 7) + " J<br>period " + figure(one.period, 7) + " s<br>" + safe(one.stability);
  }

  function familyTraces(chosen, c) {
    var traces = curve(chosen, c.series[0]), plain = [], kinds = {};
    items.forEach(function (one, k) { if (one.event) (kinds[one.kind] = kinds[one.kind] || []).push(k); else plain.push(k); });
    [true, false].forEach(function (stable) {
      var which = plain.filter(function (k) { return (items[k].stability !== "unstable") === stable; });
      traces.push(points(chosen, which, { name: "orbit", showlegend: false, marker: { size: stable ? 6 : 5,
        color: stable ? c.series[0] : c.surface, line: { width: stable ? 0 : 1.3, color: c.series[0] } } }));
    });
    Object.keys(kinds).forEach(function (kind) {
      traces.push(points(chosen, kinds[kind], { name: safe(kind).replace(/_/g, " "), marker: { symbol: SYMBOLS[kind] || "star",
        size: kind === "resonance" ? 6 : 10, color: kind === "resonance" ? c.series[3] : c.series[1],
        line: kind === "resonance" ? { width: 0 } : { width: 1.5, color: c.series[1] } } }));
    });
    return traces;
  }

  function atlasTraces(chosen, c) {
    var kinds = Array.from(new Set(items.map(function (one) { return one.stability; }))).sort();
    return kinds.map(function (kind, n) {
      var which = shown.filter(function (k) { return items[k].stability === kind; });
      return points(chosen, which, { name: safe(kind), marker: { size: 8, color: c.series[(kind === "unstable" ? 1 : n === 1 ? 2 : n) % 6],
        symbol: kind === "unstable" ? "diamond-open" : "circle", line: { width: kind === "unstable" ? 1.4 : 0.8, color: kind === "unstable" ? c.series[1] : c.surface } } });
    });
  }

  plots.plot(plot, function () {
    var chosen = axes(), c = orbitfinder.colours(), traces = family ? familyTraces(chosen, c) : atlasTraces(chosen, c);
    if (picked >= 0) traces.push({ x: [number(items[picked], chosen.x)], y: [number(items[picked], chosen.y)], mode: "markers",
      hoverinfo: "skip", showlegend: false, marker: { size: 18, symbol: "circle-open", color: c.ink, line: { width: 2.2 } } });
    return { traces: traces, layout: plots.layout(plots.axis(NAMES[chosen.x], scale(chosen.x)), plots.axis(NAMES[chosen.y], scale(chosen.y)),
      { showlegend: true, legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, margin: { l: 64, r: 16, t: 60, b: 48 } }) };
  });
  plots.plot(part("circle"), function () { return plots.circle(picked < 0 ? [] : items[picked].multipliers); });

  function pick(k) {
    if (k === picked || k < 0 || k >= items.length) return;
    var one = items[k];
    picked = k;
    scene.show(one.motion ? new orbitfinder.Motion(one.motion) : null);
    player.seek(0);
    part("still").hidden = !!one.motion;
    facts(one);
    slider.value = shown.indexOf(k);
    var text = (shown.indexOf(k) + 1) + " of " + shown.length + (one.event ? ", " + one.event : "");
    part("item-text").textContent = text;
    slider.setAttribute("aria-valuetext", text + ", energy " + figure(one.energy, 5) + " joules, period " + figure(one.period, 5) + " seconds");
    part("circle").style.visibility = one.multipliers && one.multipliers.length ? "visible" : "hidden";
    plots.redraw(plot);
    plots.redraw(part("circle"));
  }

  function facts(one) {
    var rows = [["Period", figure(one.period, 10) + " s"], ["Energy", figure(one.energy, 10) + " J"]], list = part("picked");
    if (one.event) rows.unshift(["Event", one.event]);
    if (one.title) rows.unshift(["Orbit", one.title]);
    if (one.action !== null) rows.push(["Action", figure(one.action, 8) + " J s"]);
    rows.push(["Stability", one.stability], ["Symmetry", one.symmetry]);
    if (one.event) rows.push(["Multipliers, stability", "of the orbit before the event"]);
    if (one.closure !== null) rows.push(["Closure", figure(one.closure, 5)]);
    list.textContent = "";
    rows.forEach(function (row) {
      var group = document.createElement("div"), name = document.createElement("dt"), value = document.createElement("dd");
      name.textContent = row[0];
      value.textContent = row[1];
      if (row[0] === "Orbit" && one.page) {
        var link = document.createElement("a");
        link.href = one.page;
        link.textContent = row[1];
        value.replaceChildren(link);
      }
      group.append(name, value);
      list.append(group);
    });
  }

  function choose() {
    var stability = family ? "" : part("stability").value, symmetry = family ? "" : part("symmetry").value;
    shown = items.map(function (_, k) { return k; }).filter(function (k) {
      return (!stability || items[k].stability === stability) && (!symmetry || items[k].symmetry === symmetry);
    });
    slider.max = Math.max(0, shown.length - 1);
    if (shown.indexOf(picked) < 0 && shown.length) { pick(shown[Math.floor(shown.length / 2)]); return; }
    slider.value = Math.max(0, shown.indexOf(picked));
    part("item-text").textContent = shown.length ? (shown.indexOf(picked) + 1) + " of " + shown.length : "none";
    plots.redraw(plot);
  }

  function fromPlot(event) { var k = event.points[0].customdata; if (typeof k === "number") pick(k); }
  plot.on("plotly_click", fromPlot);
  plot.on("plotly_hover", fromPlot);
  slider.addEventListener("input", function () { pick(shown[+slider.value]); });
  function step(by) { var place = shown.indexOf(picked) + by; if (place >= 0 && place < shown.length) pick(shown[place]); }
  part("previous").addEventListener("click", function () { step(-1); });
  part("next").addEventListener("click", function () { step(1); });
  ["across", "up"].forEach(function (id) {
    part(id).addEventListener("change", function () { plots.redraw(plot); });
  });
  (family ? [] : ["stability", "symmetry"]).forEach(function (id) { part(id).addEventListener("change", choose); });
  document.querySelectorAll(".pick").forEach(function (button) {
    button.addEventListener("click", function () {
      pick(+button.dataset.item);
      part("stage").scrollIntoView({ block: "center", behavior: orbitfinder.calm ? "auto" : "smooth" });
    });
  });
  part("save-csv").addEventListener("click", function () {
    var names = family ? ["energy", "period", "action", "closure", "value", "stable", "largest"]
      : ["title", "mechanism", "energy", "period", "action", "closure", "stability", "symmetry", "largest"];
    var rows = [names.join(",")], count = family ? it.columns.energy.length : items.length;
    for (var k = 0; k < count; k++) {
      rows.push(names.map(function (name) {
        var value = family ? it.columns[name][k] : items[k][name];
        return typeof value === "string" ? '"' + value.replace(/"/g, '""') + '"' : value;
      }).join(","));
    }
    orbitfinder.save(it.name.replace(/[^A-Za-z0-9_.-]+/g, "-") + ".csv", "text/csv", rows.join("\n") + "\n");
  });
  choose();
})();
