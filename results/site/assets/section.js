// A Poincare section: points by motion, curves beside them, and the picked motion moving.
(function () {
  "use strict";
  var it = orbitfinder.data.section, plots = orbitfinder.plots, player = new orbitfinder.Player(), picked = -1;
  orbitfinder.player = player;
  orbitfinder.picked = function () { return it.items[picked]; };
  function part(id) { return document.getElementById(id); }
  function safe(text) { return String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;"); }
  var plot = part("plot"), slider = part("item"), scene = player.add(part("stage"), null);
  player.controls();
  player.scrubber(function () { return picked < 0 || !it.items[picked].motion ? 0 : it.items[picked].motion.period; }, it.time);

  // All items of a kind as one trace; a regular motion has a colour that its neighbours do not share.
  function points(kind, c) {
    var x = [], y = [], which = [], colours = [], order = 0;
    it.items.forEach(function (one, k) {
      if (one.kind !== kind) return;
      var colour = kind === "chaotic" ? c.muted : kind === "undecided" ? c.ink : kind === "orbit" ? c.surface : c.series[2 + order++ % 3];
      one.x.forEach(function (value, i) { x.push(value); y.push(one.y[i]); which.push(k); colours.push(colour); });
    });
    var orbit = kind === "orbit";
    return { x: x, y: y, customdata: which, mode: "markers", name: kind, showlegend: x.length > 0,
      text: which.map(function (k) { return safe(it.items[k].name); }), hovertemplate: "%{text}<extra></extra>",
      marker: { size: orbit ? 9 : 3, color: colours, opacity: kind === "chaotic" ? 0.55 : 1,
        line: { width: orbit ? 1.6 : 0, color: c.ink } } };
  }

  function curves(c) {
    var looks = { unstable: c.series[1], stable: c.series[0], torus: c.ink, connection: c.ink };
    return it.curves.map(function (one, k) {
      var torus = one.kind === "torus", first = !torus || it.curves.findIndex(function (other) { return other.kind === "torus"; }) === k;
      var line = one.kind === "stable" || one.kind === "unstable";
      return { x: one.x, y: one.y, mode: line ? "lines" : "markers", name: torus ? "torus" : safe(one.name), hovertemplate: safe(one.name) + "<extra></extra>",
        legendgroup: torus ? "torus" : one.name, showlegend: first,
        line: { color: looks[one.kind], width: 1.3 },
        marker: { size: one.kind === "torus" ? 2 : 7, symbol: one.kind === "torus" ? "circle" : "x", color: looks[one.kind] } };
    });
  }

  plots.plot(plot, function () {
    var c = orbitfinder.colours(), kinds = it.told ? ["chaotic", "undecided", "regular"] : ["motion"];
    var traces = kinds.map(function (kind) { return points(kind, c); }).concat(curves(c), [points("orbit", c)]);
    if (picked >= 0) traces.push({ x: it.items[picked].x, y: it.items[picked].y, mode: "markers", hoverinfo: "skip",
      showlegend: false, marker: { size: 6, color: c.series[1], line: { width: 1, color: c.ink } } });
    return { traces: traces, layout: plots.layout(plots.axis(it.axes[0], { zeroline: false, fixedrange: false }), plots.axis(it.axes[1], { zeroline: false, fixedrange: false }),
      { uirevision: "section", dragmode: plots.drag, showlegend: true, legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0, itemsizing: "constant" },
        margin: { l: 64, r: 16, t: 60, b: 48 } }) };
  });

  function pick(k) {
    if (k === picked || k < 0 || k >= it.items.length) return;
    var one = it.items[k], list = part("picked");
    picked = k;
    scene.show(one.motion ? new orbitfinder.Motion(one.motion) : null);
    scene.landscape = it.landscape;
    scene.level = it.energy;
    player.seek(0);
    part("still").hidden = !!one.motion;
    list.textContent = "";
    one.facts.forEach(function (row) {
      if (!row[1]) return;
      var group = document.createElement("div"), name = document.createElement("dt"), value = document.createElement("dd");
      name.textContent = row[0];
      value.textContent = row[1];
      group.append(name, value);
      list.append(group);
    });
    slider.value = k;
    part("item-text").textContent = one.name;
    slider.setAttribute("aria-valuetext", one.name + ", " + one.kind);
    plots.redraw(plot);
  }

  var picker = plots.picker(plot, { items: it.items, pick: pick, picked: function () { return picked; },
    place: function (k) { return [it.items[k].x[0], it.items[k].y[0]]; } });
  slider.max = Math.max(0, it.items.length - 1);
  slider.addEventListener("input", function () { pick(+slider.value); picker.address(false); });
  part("previous").addEventListener("click", function () { pick(picked - 1); picker.address(false); });
  part("next").addEventListener("click", function () { pick(picked + 1); picker.address(false); });
  part("save-csv").addEventListener("click", function () {
    var rows = ["item,kind,across,up"];
    it.items.forEach(function (one, k) {
      one.x.forEach(function (value, i) { rows.push([k, one.kind, value, one.y[i]].join(",")); });
    });
    orbitfinder.save(it.name.replace(/[^A-Za-z0-9_.-]+/g, "-") + ".csv", "text/csv", rows.join("\n") + "\n");
  });
  pick(0);
  picker.open();
})();
