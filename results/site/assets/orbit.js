// The page of one orbit: motion, portraits and histories follow one clock.
(function () {
  "use strict";
  var it = orbitfinder.data.orbit, plots = orbitfinder.plots, player = new orbitfinder.Player();
  orbitfinder.player = player;
  function part(id) { return document.getElementById(id); }

  if (part("circle")) plots.plot(part("circle"), function () { return plots.circle(it.multipliers); });
  if (it.motion) moving();
  else ["moving", "histories"].forEach(function (id) { part(id).hidden = true; });

  function moving() {
    var count = it.histories.count, states = new Float32Array(orbitfinder.bytes(it.histories.data));
    var n = it.coordinates, size = it.names.length, times = [];
    // A label with its unit, where one is known.
    function labelled(text, unit) { return unit ? text + ", " + unit : text; }
    for (var k = 0; k < count; k++) times.push(it.period * k / (count - 1));
    // A component for plotting: Catmull-Rom through the samples, which are periodic up to whole turns.
    var fine = Math.max(1, Math.round(960 / (count - 1))), moments = [];
    // A hybrid motion jumps after some samples: lines are broken there.
    var jumps = new Set(it.histories.jumps || []);
    if (it.histories.jumps) fine = 1;
    for (var m = 0; m <= (count - 1) * fine; m++) {
      moments.push(it.period * m / ((count - 1) * fine));
      if (m < count - 1 && jumps.has(m)) moments.push(null);
    }
    function row(component) {
      var s = states.subarray(component * count, (component + 1) * count), last = count - 1, turned = s[last] - s[0], out = [];
      function at(i) { return i < 0 ? s[last + i] - turned : i > last ? s[i - last] + turned : s[i]; }
      for (var i = 0; i < last; i++) {
        for (var k = 0; k < fine; k++) {
          var u = k / fine, a = at(i - 1), b = at(i), c = at(i + 1), d = at(i + 2);
          out.push(b + 0.5 * u * (c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a))));
        }
        if (jumps.has(i)) out.push(null);
      }
      out.push(s[last]);
      return out;
    }
    // What leads from before each jump to after it.
    function resets(component) {
      var s = states.subarray(component * count, (component + 1) * count), out = [];
      jumps.forEach(function (i) { out.push(s[i], s[(i + 1) % count], null); });
      return out;
    }
    function value(component, time) {
      var place = (time / it.period - Math.floor(time / it.period)) * (count - 1), i = Math.floor(place), u = place - i;
      var o = component * count;
      if (jumps.has(i)) u = 0;
      return states[o + i] * (1 - u) + states[o + Math.min(i + 1, count - 1)] * u;
    }
    var scene = player.add(part("stage"), new orbitfinder.Motion(it.motion));
    scene.landscape = it.landscape;
    scene.level = it.landscape ? it.energy : null;
    if (it.landscape) scene.frame = { centre: it.motion.centre, spans: it.motion.spans, unit: it.units.length };
    player.controls();
    if (part("beside")) {
      var near = new orbitfinder.Motion(it.neighbour), show = function () {
        scene.beside = part("beside").checked ? near : null;
        part("beside-note").hidden = !scene.beside;
        player.stale = true;
      };
      part("beside").addEventListener("change", show);
      show();
    }
    player.scrubber(function () { return it.period; }, it.units.time);

    var marks = [];
    function span(i) { var all = row(i).filter(function (x) { return x !== null; }); return [Math.min.apply(null, all), Math.max.apply(null, all)]; }
    // A component that stands still is shown as a point, not as its round-off; around others there is some room.
    function range(i, others) {
      var own = span(i), most = Math.max.apply(null, others.map(function (k) { var s = span(k); return s[1] - s[0]; }));
      var middle = (own[0] + own[1]) / 2, half = own[1] - own[0] > 1e-6 * most ? 0.54 * (own[1] - own[0]) : most / 2;
      return { range: [middle - half, middle + half] };
    }
    // The sense of time: an arrow head on the curve of two components.
    function arrow(i, j, colour) {
      var k = Math.round(0.12 * count), next = Math.min(k + Math.max(1, Math.round(count / 120)), count - 1);
      function at(c, m) { return states[c * count + m]; }
      return { x: [at(i, k), at(i, next)], y: [at(j, k), at(j, next)], mode: "markers", hoverinfo: "skip",
        marker: { symbol: "arrow", size: [0, 13], angleref: "previous", color: colour } };
    }
    function name(c) { return c < n ? it.labels[c] : "rate of " + it.labels[c - n]; }
    function unitOf(c) { var u = it.axes[c % n]; return c < n || !u || !it.units.time ? u : u + "/" + it.units.time; }
    var rates = it.portraits.map(function (i) { return it.partners[i]; });
    it.portraits.forEach(function (i) {
      var box = part("portraits").querySelector('[data-component="' + i + '"]'), units = it.axes[i];
      var across = Object.assign({ nticks: 4, zeroline: false }, range(i, it.portraits));
      var up = Object.assign({ nticks: 5, zeroline: false }, range(it.partners[i], rates));
      plots.plot(box, function () {
        var colour = orbitfinder.colours().series[0];
        return { traces: [{ x: row(i), y: row(it.partners[i]), mode: "lines", hoverinfo: "x+y",
          line: { color: colour, width: 1.6 } }].concat(jumps.size ? [{ x: resets(i), y: resets(it.partners[i]),
          mode: "lines", hoverinfo: "skip", line: { color: colour, width: 1, dash: "dot" } }] : [])
          .concat([arrow(i, it.partners[i], orbitfinder.colours().series[1])]),
        layout: plots.layout(plots.axis(labelled(it.labels[i], units), across),
          plots.axis(n < size ? labelled("rate", unitOf(i + n)) : labelled(it.labels[it.partners[i]], it.axes[it.partners[i]]), up), { margin: { l: 52, r: 10, t: 8, b: 40 } }) };
      });
      marks.push({ mark: new plots.Mark(box, "dot"), component: i });
    });

    if (part("any")) {
      var any = { x: part("any-x"), y: part("any-y") }, every = it.names.map(function (_, c) { return c; });
      ["x", "y"].forEach(function (axis) {
        every.forEach(function (c) {
          var one = document.createElement("option");
          one.value = c;
          one.textContent = (c < n ? "" : "rate of ") + it.names[c % n].replace("theta", "\u03b8");
          any[axis].append(one);
        });
      });
      any.x.value = it.shown[0];
      any.y.value = it.shown.length > 1 ? it.shown[1] : it.partners[0];
      plots.plot(part("any"), function () {
        var x = +any.x.value, y = +any.y.value, c = orbitfinder.colours();
        return { traces: [{ x: row(x), y: row(y), mode: "lines", hoverinfo: "x+y", line: { color: c.series[0], width: 1.6 } }, arrow(x, y, c.series[1])],
          layout: plots.layout(plots.axis(labelled(name(x), unitOf(x)), Object.assign({ zeroline: false }, range(x, every))),
            plots.axis(labelled(name(y), unitOf(y)), Object.assign({ zeroline: false }, range(y, every)))) };
      });
      var spot = new plots.Mark(part("any"), "dot");
      player.followers.push(function (time) { spot.move(value(+any.x.value, time), value(+any.y.value, time)); });
      ["x", "y"].forEach(function (axis) {
        any[axis].addEventListener("change", function () { plots.redraw(part("any")); player.stale = true; });
      });
    }

    var kinds = Array.from(new Set(it.shown.map(function (i) { return it.axes[i]; }))).filter(Boolean).join(" or ");
    // States of a first-order system whose units differ from the first one's have a plot of their own.
    var T = it.units.time, other = n < size ? [] : it.shown.filter(function (i) { return it.axes[i] !== it.axes[it.shown[0]]; });
    var same = it.shown.filter(function (i) { return other.indexOf(i) < 0; });
    function named(which) { return which.map(function (i) { return it.labels[i]; }).join(", "); }
    function kind(which) { return Array.from(new Set(which.map(function (i) { return it.axes[i]; }))).filter(Boolean).join(" or "); }
    part("velocities").hidden = n === size && !other.length;
    if (other.length) part("velocities").setAttribute("aria-label", "The other states over one period");
    var both = [["coordinates", 0, kind(same), same, other.length ? named(same) : "coordinates"],
      n < size ? ["velocities", n, T ? kinds.replace(/[^ ]+(?= or |$)/g, "$&/" + T) : "", it.shown, "velocities"] : ["velocities", 0, kind(other), other, named(other)]];
    var lines = (n < size || other.length ? both : both.slice(0, 1)).map(function (one) {
      var box = part(one[0]);
      plots.plot(box, function () {
        var c = orbitfinder.colours(), dashes = ["solid", "dash", "dot"];
        return { traces: one[3].map(function (i, k) {
          return { x: moments, y: row(i + one[1]), mode: "lines", name: it.labels[i],
            line: { color: c.series[k % c.series.length], width: 1.7, dash: dashes[Math.floor(k / c.series.length) % 3] } };
        }),
        layout: plots.layout(plots.axis(labelled("time", it.units.time), { range: [0, it.period] }), plots.axis(labelled(one[4], one[2])),
          { showlegend: true, hovermode: "x", legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
            margin: { l: 60, r: 14, t: 40, b: 44 } }) };
      });
      box.on("plotly_click", function (event) { player.seek(event.points[0].x); });
      return new plots.Mark(box, "line");
    });
    if (it.energies) {
      var split = new Float32Array(orbitfinder.bytes(it.energies.data)), many = it.energies.count, box = part("energies");
      var sums = [0, 1, 2].map(function (k) {
        return Array.from({ length: many }, function (_, m) { return k < 2 ? split[k * many + m] : split[m] + split[many + m]; });
      });
      plots.plot(box, function () {
        var c = orbitfinder.colours();
        return { traces: ["kinetic", "potential", "sum"].map(function (what, k) {
          return { x: sums[0].map(function (_, m) { return it.period * m / (many - 1); }), y: sums[k], mode: "lines", name: what,
            line: { color: c.series[[1, 2, 5][k]], width: 1.7, shape: "spline", dash: k === 2 ? "dash" : "solid" } };
        }), layout: plots.layout(plots.axis(labelled("time", it.units.time), { range: [0, it.period] }),
          plots.axis(labelled("energy", it.units.energy)), { showlegend: true, hovermode: "x",
            legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, margin: { l: 60, r: 14, t: 40, b: 44 } }) };
      });
      box.on("plotly_click", function (event) { player.seek(event.points[0].x); });
      lines.push(new plots.Mark(box, "line"));
    }
    player.followers.push(function (time) {
      var within = time - it.period * Math.floor(time / it.period);
      marks.forEach(function (one) { one.mark.move(value(one.component, time), value(it.partners[one.component], time)); });
      lines.forEach(function (line) { line.move(within); });
    });

    part("save-csv").addEventListener("click", function () {
      var out = ["t," + it.names.join(",")];
      for (var k = 0; k < count; k++) {
        var cells = [times[k]];
        for (var c = 0; c < size; c++) cells.push(+states[c * count + k].toPrecision(8));
        out.push(cells.join(","));
      }
      orbitfinder.save(it.name + ".csv", "text/csv", out.join("\n") + "\n");
    });
  }

  if (!it.motion) part("save-csv").hidden = true;
  part("save-json").addEventListener("click", function () { orbitfinder.save(it.name + ".json", "application/json", it.json + "\n"); });
  if (part("save-toml")) part("save-toml").addEventListener("click", function () {
    orbitfinder.save(it.name + ".toml", "text/plain", part("problem").textContent);
  });
  document.querySelectorAll("[data-copy]").forEach(function (button) {
    var before = button.textContent;
    button.addEventListener("click", function () {
      var area = document.createElement("textarea");
      area.value = part(button.dataset.copy).textContent;
      document.body.appendChild(area);
      area.select();
      button.textContent = document.execCommand("copy") ? "Copied" : "Select and copy by hand";
      area.remove();
      button.focus();
      setTimeout(function () { button.textContent = before; }, 1500);
    });
  });
})();
