// Families and atlases: a plot on which an orbit is picked, and the picked orbit moving beside it.
(function () {
  "use strict";
  var it = orbitfinder.data.explorer, plots = orbitfinder.plots, player = new orbitfinder.Player();
  var family = it.page === "family", figure = orbitfinder.figure, items = it.items, shown = [], picked = -1, kept = -1;
  orbitfinder.player = player;
  orbitfinder.picked = function () { return items[picked]; };
  function part(id) { return document.getElementById(id); }
  var phone = matchMedia("(max-width: 860px)"), plot = part("plot"), slider = part("item"), scene = player.add(part("stage"), null);
  var beside = player.add(part("kept"), null);
  player.controls();
  player.scrubber(function () { return picked < 0 ? 0 : items[picked].period; }, it.units.time);

  function unit(text, one) { return one ? text + ", " + one : text; }
  var E = it.units.energy, S = it.units.time, energetic = it.energetic !== false;
  var NAMES = { energy: unit(it.conserved ? "energy" : "energy at t = 0", E), frequency: unit("frequency", S && "1/" + S),
    period: unit("period", S), action: unit("action", it.units.action), amplitude: (it.curve ? "" : "amplitude of ") + safe(it.moved || ""),
    largest: "largest multiplier", value: safe(it.parameter), below: unit("energy below the highest", E),
    arclength: "place along the family (arclength)", moduli: "|multipliers|", angles: "angle of multipliers, °" };
  var highest = Math.max.apply(null, items.map(function (one) { return one.energy; }));

  function axes() { return { x: part("across").value, y: part("up").value }; }
  function alike(name) {
    var all = items.map(function (one) { return number(one, name); }), most = Math.max.apply(null, all);
    return most - Math.min.apply(null, all) < 1e-6 * Math.max(Math.abs(most), 1e-12);
  }
  // A search at a few energies is told apart by period and instability.
  var levels = new Set(items.map(function (one) { return one.energy.toPrecision(6); })).size;
  if (!family && items.length > 1 && (alike("energy") || levels <= items.length / 10)) {
    part("across").value = "period";
    part("up").value = alike("largest") ? "action" : "largest";
  }
  function number(one, name) {
    if (name === "frequency") return 1 / one.period;
    if (name === "below") return highest > one.energy ? highest - one.energy : null;
    if (name !== "largest") return one[name];
    if (one.largest !== undefined) return one.largest;
    if (!one.multipliers) return null;
    return one.multipliers.reduce(function (most, pair) { return Math.max(most, Math.hypot(pair[0], pair[1])); }, 1);
  }
  function column(name) {
    var c = it.columns;
    if (name === "below") return c.energy.map(function (one) { return highest > one ? highest - one : null; });
    return name === "frequency" ? c.period.map(function (T) { return 1 / T; }) : c[name];
  }
  // Whether an axis can be logarithmic; some always are.
  function positive(name) {
    if (name === "angles") return false;
    if (name === "moduli") return true;
    return items.every(function (one) { var x = number(one, name); return x === null || x === undefined || x > 0; });
  }
  function always(name) { return name === "largest" || name === "below" || name === "moduli"; }
  function logarithms(chosen) {
    [["log-x", chosen.x], ["log-y", chosen.y]].forEach(function (one) {
      part(one[0]).disabled = always(one[1]) || !positive(one[1]);
    });
  }
  function scale(name, box) {
    if (name === "angles") return { range: [-6, 186], dtick: 30 };
    var log = always(name) || (part(box).checked && positive(name));
    if (!items.length || name === "moduli" || !alike(name)) return log ? { type: "log" } : {};
    var one = number(items[0], name), room = Math.max(0.05 * Math.abs(one), 1e-6);
    return log ? { type: "log", range: [Math.log10(one) - 0.05, Math.log10(one) + 0.05] } : { range: [one - room, one + room] };
  }

  // The curve in runs of one stability each, that meet at the event where it changes: solid where stable, dashed where
  // not, dotted where nothing decides.
  var STYLES = { "true": ["stable", 2.6, "solid"], "false": ["unstable", 1.6, "dash"], "null": ["undecided", 2, "dot"] };
  function curve(chosen, c) {
    var x = column(chosen.x), y = column(chosen.y), stable = it.columns.stable, traces = [], named = {}, from = 0, meet = null;
    function middle(all, k) { return all[k] === null || all[k - 1] === null ? null : (all[k] + all[k - 1]) / 2; }
    it.changes.concat([[x.length, null]]).forEach(function (change) {
      var end = change[0], style = STYLES[stable[from]], place = [x.slice(from, end), y.slice(from, end)], before = meet;
      meet = end === x.length ? null : [chosen.x, chosen.y].map(function (name, axis) {
        var at = change[1] && number(change[1], name);
        return at === null || at === undefined || !isFinite(at) ? middle(axis ? y : x, end) : at;
      });
      place.forEach(function (all, axis) {
        if (before) all.unshift(before[axis]);
        if (meet) all.push(meet[axis]);
      });
      traces.push({ x: place[0], y: place[1], mode: "lines", hoverinfo: "skip", name: style[0], legendgroup: style[0],
        showlegend: !named[style[0]], line: { color: stable[from] === null ? c.muted : c.series[0], width: style[1], dash: style[2] } });
      named[style[0]] = true;
      from = end;
    });
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
      (energetic ? unit("energy " + figure(one.energy, 7), E).replace(",", "") + "<br>" : "") +
      unit("period " + figure(one.period, 7), S).replace(",", "") + "<br>" + safe(one.stability);
  }

  function familyTraces(chosen, c) {
    var traces = curve(chosen, c), plain = [], kinds = {};
    items.forEach(function (one, k) { if (one.event) (kinds[one.kind] = kinds[one.kind] || []).push(k); else plain.push(k); });
    ["stable", "unstable", "marginal"].forEach(function (kind) {
      var which = plain.filter(function (k) { var said = items[k].stability; return kind === (said === "unstable" || said === "marginal" ? said : "stable"); });
      var colour = kind === "marginal" ? c.muted : c.series[0];
      if (which.length) traces.push(points(chosen, which, { name: "orbit", showlegend: false, marker: { size: kind === "stable" ? 6 : 5,
        symbol: kind === "marginal" ? "square" : "circle", color: kind === "stable" ? colour : c.surface,
        line: { width: kind === "stable" ? 0 : 1.3, color: colour } } }));
    });
    Object.keys(kinds).forEach(function (kind) {
      var look = it.looks[kind], colour = c.series[look[1]];
      traces.push(points(chosen, kinds[kind], { name: safe(kind).replace(/_/g, " "), marker: { symbol: look[0],
        size: look[2], color: colour, line: { width: look[3], color: colour } } }));
    });
    return traces;
  }

  // All multipliers of the orbits that can be picked: sizes by what they do, angles on the circle by Krein's sign.
  function multiplierTraces(chosen, c) {
    var angles = chosen.y === "angles", kinds = {};
    items.forEach(function (one, k) {
      (one.event ? [] : one.multipliers).forEach(function (pair, m) {
        var size = Math.hypot(pair[0], pair[1]), round = Math.abs(size - 1) < 1e-3, krein = (one.krein || [])[m] || 0, kind;
        if (angles && (!round || pair[1] < 0)) return;
        if (angles) kind = krein > 0 ? "Krein sign +" : krein < 0 ? "Krein sign \u2212" : "no Krein sign";
        else kind = round ? "on the circle" : Math.abs(pair[1]) > 1e-6 * size ? "complex, off the circle" : pair[0] > 0 ? "real, > 0" : "real, < 0";
        var group = kinds[kind] = kinds[kind] || { x: [], y: [], customdata: [] };
        group.x.push(number(one, chosen.x));
        group.y.push(angles ? Math.abs(Math.atan2(pair[1], pair[0])) * 180 / Math.PI : size);
        group.customdata.push(k);
      });
    });
    var order = ["on the circle", "real, > 0", "real, < 0", "complex, off the circle", "Krein sign +", "Krein sign \u2212", "no Krein sign"];
    return order.filter(function (kind) { return kinds[kind]; }).map(function (kind) {
      var n = order.indexOf(kind) % 4;
      return Object.assign(kinds[kind], { name: kind, mode: "markers", text: kinds[kind].customdata.map(label),
        hovertemplate: "%{text}<extra></extra>",
        marker: { size: 6, color: c.series[n], symbol: ["circle", "diamond", "square", "cross"][n] } });
    });
  }

  // Shapes say the stability; colours too, or, where it is on neither axis, the energy.
  function atlasTraces(chosen, c) {
    var told = levels > 1 && it.conserved && chosen.x !== "energy" && chosen.y !== "energy" && chosen.x !== "below";
    var least = Math.min.apply(null, items.map(function (one) { return one.energy; }));
    if (told) return ["", "unstable"].map(function (kind) {
      var which = shown.filter(function (k) { return (items[k].stability === "unstable") === (kind !== ""); });
      return points(chosen, which, { name: kind || "not unstable", marker: { size: 9, symbol: kind ? "diamond-open" : "circle",
        color: which.map(function (k) { return items[k].energy; }), cmin: least, cmax: highest, showscale: !kind || !shown.some(function (k) { return items[k].stability !== "unstable"; }),
        colorscale: [[0, c.series[0]], [1, c.series[1]]], colorbar: { title: { text: NAMES.energy, side: "right" }, thickness: 10, outlinewidth: 0 } } });
    }).filter(function (trace) { return trace.x.length; });
    var kinds = Array.from(new Set(items.map(function (one) { return one.stability; }))).sort();
    return kinds.map(function (kind, n) {
      var which = shown.filter(function (k) { return items[k].stability === kind; });
      return points(chosen, which, { name: safe(kind), marker: { size: 8, color: c.series[(kind === "unstable" ? 1 : n === 1 ? 2 : n) % 6],
        symbol: kind === "unstable" ? "diamond-open" : "circle", line: { width: kind === "unstable" ? 1.4 : 0.8, color: kind === "unstable" ? c.series[1] : c.surface } } });
    });
  }

  plots.plot(plot, function () {
    var chosen = axes(), c = orbitfinder.colours(), many = chosen.y === "moduli" || chosen.y === "angles";
    var traces = many ? multiplierTraces(chosen, c) : family ? familyTraces(chosen, c) : atlasTraces(chosen, c);
    logarithms(chosen);
    if (picked >= 0 && many) {
      var at = number(items[picked], chosen.x);
      traces.push({ x: [at, at], y: chosen.y === "angles" ? [0, 180] : moduliRange().map(function (one) { return Math.pow(10, one); }), mode: "lines", hoverinfo: "skip", showlegend: false,
        line: { color: c.ink, width: 1.2, dash: "dot" } });
    }
    if (kept >= 0 && !many) traces.push({ x: [number(items[kept], chosen.x)], y: [number(items[kept], chosen.y)], mode: "markers",
      hoverinfo: "skip", showlegend: false, marker: { size: 16, symbol: "square-open", color: c.ink, line: { width: 2 } } });
    var up = scale(chosen.y, "log-y");
    if (chosen.y === "moduli") up.range = moduliRange();
    return { traces: traces, layout: plots.layout(plots.axis(NAMES[chosen.x], Object.assign(scale(chosen.x, "log-x"), { fixedrange: false })),
      plots.axis(NAMES[chosen.y], Object.assign(up, { fixedrange: false })),
      { uirevision: [chosen.x, chosen.y, part("log-x").checked, part("log-y").checked].join(), showlegend: true,
        dragmode: plots.drag, legend: Object.assign({ orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, phone.matches ? { entrywidth: 105, font: { size: 12 }, x: -0.15 } : {}),
        margin: { l: 64, r: 16, t: 60, b: 48 } }) };
  });
  plots.plot(part("circle"), function () { return plots.circle(picked < 0 ? [] : items[picked].multipliers); });

  function moduliRange() {
    var most = Math.max.apply(null, items.map(function (one) { return one.multipliers.length ? number(one, "largest") : 1; }));
    var wide = 1.05 * Math.log10(Math.max(2, most));
    return [-wide, wide];
  }

  // Where the picked orbit is: a ring that glides there, and brings a zoomed view along.
  var ring = new plots.Mark(plot, "ring");
  function ringed(lasting) {
    var chosen = axes(), full = plot._fullLayout, change = {};
    if (picked < 0 || !full) { ring.node.hidden = true; return; }
    var at = [number(items[picked], chosen.x), number(items[picked], chosen.y)];
    ring.node.hidden = at.some(function (x) { return x === null || x === undefined || !isFinite(x); });
    if (ring.node.hidden) return;
    [full.xaxis, full.yaxis].forEach(function (axis, d) {
      var place = axis.d2l(at[d]), half = (axis.range[1] - axis.range[0]) / 2;
      if (!axis.autorange && isFinite(place) && Math.abs(place - axis.range[0] - half) > half * 1.001) change[axis._name + ".range"] = [place - half, place + half];
    });
    ring.node.style.transitionDuration = (orbitfinder.calm ? 0 : lasting) + "ms";
    if (lasting && Object.keys(change).length) Plotly.relayout(plot, change); else ring.move(at[0], at[1]);
    ring.node.hidden = !lasting && Object.keys(change).length > 0;
  }
  plot.on("plotly_afterplot", function () { ringed(0); });

  function pick(k, lasting) {
    if (k === picked || k < 0 || k >= items.length) return;
    var one = items[k], before = picked < 0 ? 0 : items[picked].period, many = axes().y === "moduli" || axes().y === "angles";
    picked = k;
    scene.show(one.motion ? new orbitfinder.Motion(one.motion) : null, family && before && (lasting || 260));
    if (family) part("says").textContent = one.says;
    scene.landscape = it.landscape;
    scene.level = one.energy;
    player.turn(before, one.period);
    part("still").hidden = !!one.motion;
    facts(one);
    slider.value = shown.indexOf(k);
    var text = (shown.indexOf(k) + 1) + " of " + shown.length + (one.event ? ", " + one.event : "");
    part("item-text").textContent = text;
    slider.setAttribute("aria-valuetext", text + (energetic ? ", energy " + figure(one.energy, 5) + " " + E : "") + ", period " + figure(one.period, 5) + " " + S);
    part("circle").style.visibility = one.multipliers && one.multipliers.length ? "visible" : "hidden";
    if (many) plots.redraw(plot); else ringed(lasting || 260);
    plots.redraw(part("circle"));
  }

  // Along the family by itself, slowly enough at events to read what happens there.
  var going = null;
  function travel(on) {
    clearTimeout(going);
    going = null;
    part("travel").textContent = on ? "Stop" : "Go along";
    part("travel").setAttribute("aria-pressed", String(on));
    if (!on) return picker.address(false);
    var place = shown.indexOf(picked), next = place + 1 < shown.length ? place + 1 : 0;
    (function on_() {
      var one = items[shown[next]];
      pick(shown[next], 420);
      next++;
      going = next < shown.length ? setTimeout(on_, !one.event ? 420 : one.kind === "resonance" ? 1200 : 2600) : setTimeout(travel, 900, false);
    })();
  }
  if (family) part("travel").addEventListener("click", function () { picker.lock(true); travel(!going); });

  var picker = plots.picker(plot, { items: items, pick: pick, picked: function () { return picked; },
    place: function (k) { var chosen = axes(); return [number(items[k], chosen.x), number(items[k], chosen.y)]; },
    more: function () { return kept < 0 ? "" : "&with=" + encodeURI(items[kept].key); }, read: keep });

  // A second orbit beside the picked one, at the same clock; its numbers stand in a column of their own.
  function keep(k) {
    kept = k;
    part("kept-box").hidden = k < 0;
    part("keep").setAttribute("aria-pressed", String(k >= 0));
    beside.show(k >= 0 && items[k].motion ? new orbitfinder.Motion(items[k].motion) : null);
    beside.landscape = it.landscape;
    beside.level = k >= 0 ? items[k].energy : null;
    player.stale = true;
    if (picked >= 0) facts(items[picked]);
    plots.redraw(plot);
  }
  part("keep").addEventListener("click", function () { keep(kept < 0 ? picked : -1); picker.address(true); });

  function told(one) {
    var rows = [["Period", figure(one.period, 10) + " " + S]];
    if (energetic && (it.conserved || !one.event)) rows.push([it.conserved ? "Energy" : "Energy at t = 0", figure(one.energy, 10) + " " + E]);
    if (family && it.parameter !== "energy" && it.parameter !== "period") rows.push([it.parameter, figure(one.value, 10)]);
    if (one.event) rows.unshift(["Event", one.event]);
    if (one.error) rows.push(["Error bar of " + it.parameter, figure(one.error, 2)]);
    if (one.title) rows.unshift(["Orbit", one.title]);
    if (one.action !== null) rows.push(["Action", figure(one.action, 8) + " " + it.units.action]);
    if (one.on && one.on.length) rows.push(["Lies on", one.on.map(function (way) { return way[1]; }).join(", ")]);
    rows.push(["Stability", one.stability], ["Symmetry", one.symmetry]);
    if (one.event) rows.push(["Multipliers, stability", "of the orbit before the event"]);
    if (one.closure !== null) rows.push(["Closure", figure(one.closure, 3)]);
    if (one.closure > 1e-8 && one.defect !== null && one.defect !== undefined) {
      rows[rows.length - 1][0] = "Closure in one turn";
      rows.push(["Closure piece by piece", figure(one.defect, 3)], ["Why two", "one turn multiplies errors too much to say anything; between its nodes it closes"]);
    }
    return rows;
  }

  function facts(one) {
    var list = part("picked"), other = kept < 0 ? [] : told(items[kept]);
    part("command").textContent = one.command || "";
    part("command-box").hidden = !one.command;
    list.textContent = "";
    told(one).forEach(function (row) {
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
      var same = other.find(function (one) { return one[0] === row[0]; });
      if (kept >= 0) {
        var second = document.createElement("dd");
        second.className = "kept";
        second.textContent = same ? same[1] : "\u2013";
        group.append(second);
      }
      if (row[0] === "Lies on") value.replaceChildren.apply(value, one.on.map(function (way) {
        var link = document.createElement("a");
        link.href = way[0];
        link.textContent = way[1];
        link.style.display = "block";
        return link;
      }));
      list.append(group);
    });
  }

  function nothing() {
    picked = -1;
    scene.show(null);
    player.stale = true;
    part("picked").textContent = "";
    part("command-box").hidden = true;
    part("circle").style.visibility = "hidden";
  }

  function choose() {
    var stability = family ? "" : part("stability").value, symmetry = family ? "" : part("symmetry").value;
    shown = items.map(function (_, k) { return k; }).filter(function (k) {
      return (!stability || items[k].stability === stability) && (!symmetry || items[k].code === symmetry);
    });
    slider.max = Math.max(0, shown.length - 1);
    if (shown.indexOf(picked) < 0 && shown.length) pick(shown[Math.floor(shown.length / 2)]);
    if (!shown.length) nothing();
    slider.value = Math.max(0, shown.indexOf(picked));
    part("item-text").textContent = shown.length ? (shown.indexOf(picked) + 1) + " of " + shown.length : "none";
    plots.redraw(plot);
  }

  part("alike").hidden = part("alike-label").hidden = !it.frame;
  function frame() {
    scene.frame = beside.frame = part("alike").checked && it.frame ? Object.assign({ unit: it.units.length }, it.frame) : null;
    scene.width = beside.width = 0;
    player.stale = true;
  }
  part("alike").addEventListener("change", frame);
  frame();
  function rest() { if (going) travel(false); }
  slider.addEventListener("input", function () { rest(); pick(shown[+slider.value]); picker.address(false); });
  function step(by) { rest(); var place = shown.indexOf(picked) + by; if (place >= 0 && place < shown.length) { pick(shown[place]); picker.address(false); } }
  part("previous").addEventListener("click", function () { step(-1); });
  part("next").addEventListener("click", function () { step(1); });
  function heading() {
    function word(id) { return part(id).selectedOptions[0].textContent; }
    var text = word("up") + " against " + word("across");
    part("plot-heading").textContent = text.charAt(0).toUpperCase() + text.slice(1);
    plot.setAttribute("aria-label", part("plot-heading").textContent + "; the slider below goes through the points");
  }
  ["across", "up", "log-x", "log-y"].forEach(function (id) {
    part(id).addEventListener("change", function () { heading(); plots.redraw(plot); });
  });
  heading();
  (family ? [] : ["stability", "symmetry"]).forEach(function (id) { part(id).addEventListener("change", choose); });
  document.querySelectorAll(".pick").forEach(function (button) {
    button.addEventListener("click", function () {
      rest();
      pick(+button.dataset.item);
      picker.lock(true);
      picker.address(true);
      part("stage").scrollIntoView({ block: "center", behavior: orbitfinder.calm ? "auto" : "smooth" });
    });
  });
  part("save-csv").addEventListener("click", function () {
    var names = family ? ["energy", "period", "action", "closure", "value", "arclength", "stable", "largest"]
      : ["title", "key", "mechanism", "energy", "period", "action", "closure", "stability", "symmetry", "largest"];
    if (!energetic) names = names.filter(function (name) { return name !== "energy" && name !== "action"; });
    var rows = [names.join(",")], count = family ? it.columns.energy.length : items.length;
    for (var k = 0; k < count; k++) {
      rows.push(names.map(function (name) {
        var value = family ? it.columns[name][k] : items[k][name];
        return typeof value === "string" ? '"' + value.replace(/"/g, '""') + '"' : value;
      }).join(","));
    }
    orbitfinder.save(it.name.replace(/[^A-Za-z0-9_.-]+/g, "-") + ".csv", "text/csv", rows.join("\n") + "\n");
  });
  // On a phone the motion stands between the plot and its slider, and the axes are folded away.
  var box = part("stage").parentNode, after = box.nextElementSibling;
  function arrange() {
    part("view").open = !phone.matches;
    if (phone.matches) slider.parentNode.before(box); else after.before(box);
  }
  phone.addEventListener("change", arrange);
  arrange();
  choose();
  picker.open();
  addEventListener("pageshow", function () { heading(); choose(); });
})();
