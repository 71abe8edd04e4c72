// The stage of the studio: a motion plays; the joints of a chain can be dragged, and flicked on release. Points of other
// mechanisms are pulled: the server says how the rest follows.
var stage = (function () {
  "use strict";
  var REACH = 26, FLICK = 90, STILL = 40; // px, ms, px a second
  var canvas, pen, player, scene, told, view, lengths, angles, rates, scale = 1, grabbed = -1, trail = [], reel = [], points = [], pulled = -1;

  function place(k) {
    var x = canvas.clientWidth / 2 - view.centre[1] * scale, y = canvas.clientHeight / 2 - view.centre[0] * scale;
    for (var i = 0; i < k; i++) { x += scale * lengths[i] * Math.sin(angles[i]); y += scale * lengths[i] * Math.cos(angles[i]); }
    return [x, y];
  }

  function fit() { scale = 0.84 * Math.min(canvas.clientHeight / view.spans[0], canvas.clientWidth / view.spans[1]); }

  // A chain as it is held.
  function draw() {
    var c = orbitfinder.colours(), ratio = Math.min(window.devicePixelRatio || 1, 2), p, k;
    canvas.width = canvas.clientWidth * ratio;
    canvas.height = canvas.clientHeight * ratio;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    fit();
    pen.lineWidth = 6;
    pen.lineCap = pen.lineJoin = "round";
    pen.strokeStyle = c.link;
    pen.beginPath();
    for (k = 0; k <= lengths.length; k++) { p = place(k); pen.lineTo(p[0], p[1]); }
    pen.stroke();
    for (k = 0; k <= lengths.length; k++) {
      p = place(k);
      pen.fillStyle = k ? c.joint : c.ground;
      pen.beginPath();
      pen.arc(p[0], p[1], k === grabbed + 1 && grabbed >= 0 ? 12 : 9, 0, 7);
      pen.fill();
    }
  }

  function at(event) { var box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; }

  // The joints where the motion that plays has them now.
  function caught() {
    if (!scene || !scene.motion) return;
    var m = scene.motion, now = m.at(player.time);
    for (var k = 0; k < lengths.length; k++) {
      angles[k] = Math.atan2(now[k + 1 + m.points] - now[k + m.points], now[k + 1] - now[k]);
      rates[k] = 0;
    }
  }

  // Where a point of what plays is, in px; where px are, in m down and right, in space as far from the eye as the point.
  function placed(time) {
    if (scene.width !== canvas.clientWidth) scene.fit(); // another motion came since the last picture
    return scene.motion.at(time);
  }
  function spot(k, time) {
    var now = placed(time);
    return [scene.across(now, k), scene.down(now, k)];
  }
  function metres(p) {
    var now = placed(player.time);
    if (scene.view) {
      var held = scene.point(now, pulled), v = scene.view, m = scene.motion;
      return [0, 1, 2].map(function (d) { return now[pulled + d * m.points] +
        ((p[1] - held[1]) * v[0][d] + (p[0] - held[0]) * v[1][d]) / scene.scale; });
    }
    return [scene.centre[0] + (p[1] - scene.height / 2) / scene.scale, scene.centre[1] + (p[0] - scene.width / 2) / scene.scale];
  }

  function grip(event) {
    var p = at(event), best = REACH, time = player.time % scene.motion.period;
    points.forEach(function (k) {
      var q = spot(k, time), far = Math.hypot(q[0] - p[0], q[1] - p[1]);
      if (far <= best) { best = far; pulled = k; }
    });
    if (pulled < 0) return;
    event.stopImmediatePropagation(); // elsewhere the view is turned
    canvas.setPointerCapture(event.pointerId);
    player.playing = false;
    trail = [[performance.now(), metres(p)]];
    emitEvent("gripped", { point: pulled, time: time });
  }

  function pull(event) {
    var now = performance.now(), place = metres(at(event));
    trail.push([now, place]);
    while (trail.length > 2 && now - trail[0][0] > FLICK) trail.shift();
    if (now - told < 30) return;
    told = now;
    emitEvent("gripped", { place: place });
  }

  function let_go() {
    var now = performance.now(), recent = trail.filter(function (one) { return now - one[0] <= FLICK; });
    var last = trail[trail.length - 1], velocity = last[1].map(function () { return 0; });
    if (recent.length > 1) {
      var first = recent[0], passed = (last[0] - first[0]) / 1000;
      var found = last[1].map(function (_, c) { return passed > 0.01 ? (last[1][c] - first[1][c]) / passed : 0; });
      if (Math.hypot.apply(null, found) * scene.scale > STILL) velocity = found;
    }
    pulled = -1;
    player.playing = !orbitfinder.calm;
    emitEvent("gripped", { place: last[1], velocity: velocity });
  }

  function down(event) {
    if (points.length && scene && scene.motion) return grip(event);
    if (!lengths.length) return;
    fit();
    caught();
    var p = at(event), best = REACH;
    grabbed = -1;
    for (var k = 1; k <= lengths.length; k++) {
      var q = place(k), far = Math.hypot(q[0] - p[0], q[1] - p[1]);
      if (far <= best) { best = far; grabbed = k - 1; }
    }
    if (grabbed < 0) return;
    canvas.setPointerCapture(event.pointerId);
    hold(true);
    trail = [[performance.now(), angles[grabbed]]];
    draw();
  }

  function hold(held) {
    if (held) player.visible.delete(scene); else player.visible.add(scene);
    player.playing = !held && !orbitfinder.calm;
    scene.width = 0;
    player.stale = true;
  }

  function move(event) {
    if (pulled >= 0) return pull(event);
    if (grabbed < 0) return;
    var p = at(event), q = place(grabbed);
    angles[grabbed] = Math.atan2(p[0] - q[0], p[1] - q[1]);
    var now = performance.now();
    trail.push([now, angles[grabbed]]);
    while (trail.length > 2 && now - trail[0][0] > FLICK) trail.shift();
    draw();
    tell("held");
  }

  // A joint that is let go of while it moves keeps the rate of its last moments.
  function up() {
    if (pulled >= 0) return let_go();
    if (grabbed < 0) return;
    var now = performance.now(), recent = trail.filter(function (one) { return now - one[0] <= FLICK; });
    if (recent.length > 1) {
      var first = recent[0], last = recent[recent.length - 1], turned = last[1] - first[1], passed = (last[0] - first[0]) / 1000;
      turned -= 2 * Math.PI * Math.round(turned / (2 * Math.PI));
      var rate = passed > 0.01 ? turned / passed : 0;
      if (Math.abs(rate) * lengths[grabbed] * scale > STILL) rates[grabbed] = rate;
    }
    grabbed = -1;
    hold(false);
    tell("released");
  }

  function tell(what) {
    var now = performance.now();
    if (what === "held" && now - told < 80) return;
    told = now;
    emitEvent(what, { state: angles.concat(rates) });
  }

  function mount(id, links, others) {
    canvas = document.getElementById(id);
    pen = canvas.getContext("2d");
    player = orbitfinder.player = new orbitfinder.Player();
    told = 0;
    lengths = links;
    points = others;
    angles = links.map(function () { return 0; });
    rates = angles.slice();
    canvas.addEventListener("pointerdown", down);
    canvas.addEventListener("pointermove", move);
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
  }

  // The part of the plane that holds two.
  function both(one, other) {
    var sides = one.centre.map(function (_, k) {
      function side(of, sign) { return of.centre[k] + sign * of.spans[k] / 2; }
      return [Math.min(side(one, -1), side(other, -1)), Math.max(side(one, 1), side(other, 1))];
    });
    return { centre: sides.map(function (s) { return (s[0] + s[1]) / 2; }), spans: sides.map(function (s) { return s[1] - s[0]; }) };
  }

  // Another motion in the same window; on the same family it goes on at the same share of its period.
  function show(packed, window_, keep) {
    var motion = new orbitfinder.Motion(packed), before = scene && scene.motion;
    if (window_) view = keep && view ? both(view, window_) : window_;
    motion.centre = view.centre;
    motion.spans = view.spans;
    if (scene) scene.show(motion); else scene = player.add(canvas, motion);
    if (grabbed < 0) player.turn(before && keep ? before.period : 0, motion.period);
    stage.shown++;
  }

  // The orbits of a family, so that sliding along it waits for nobody; what is missing the server sends.
  function put(films) { reel = films; }
  function turn(k) { if (reel[k]) show(reel[k], null, true); }
  function add(k, film) { reel[k] = film; turn(k); }
  function links(found, others) { lengths = found; points = others; }
  function play(on) { player.playing = on; player.stale = true; }
  function recolour() { document.dispatchEvent(new Event("orbitfinder-theme")); }
  function joint(k) {
    if (points.length) return spot(k, player.time);
    caught();
    fit();
    return place(k);
  }
  function rewind() { player.speed = 0; player.seek(0); }

  return { mount: mount, links: links, put: put, turn: turn, add: add, show: show, play: play, recolour: recolour, joint: joint, rewind: rewind, shown: 0, rates: function () { return rates; },
    speed: function (value) { player.speed = value; } };
})();
