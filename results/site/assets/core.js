// Data, moving mechanisms, and the one clock that all of a page follow.
var orbitfinder = (function () {
  "use strict";
  var data = {};
  var calm = matchMedia("(prefers-reduced-motion: reduce)").matches;

  function put(key, payload) { data[key] = payload; }

  function bytes(text) {
    var raw = atob(text), out = new Uint8Array(raw.length);
    for (var i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  }

  // Positions of one orbit. Of m points channel c < m is x (down) of point c, then y (right), in space then z (to the
  // eye), then the angle of what turns rigidly about its parent; see site/motion.py.
  function Motion(packed) {
    this.period = packed.period;
    this.dims = packed.dims;
    this.span = packed.period * (packed.rounds || 1); // s after which all is where it was
    this.drift = packed.drift || null; // [down, right] a period, seen from beside it
    this.around = packed.around || null;
    this.count = packed.count;
    this.points = packed.points;
    this.centre = packed.centre;
    this.spans = packed.spans.map(function (span) { return Math.max(span, 1e-9); });
    this.moving = packed.moving;
    this.drawn = packed.drawn;
    this.jumps = new Set(packed.jumps || []);
    this.ground = packed.ground || null;
    this.strokes = packed.strokes || null;
    this.rods = packed.rods || [];
    this.broken = false;
    this.now = new Float32Array((packed.dims + 1) * packed.points);
    this.fixed = [];
    var still = packed.still, many = packed.points, first = packed.dims * many, values = new Int16Array(bytes(packed.data)), about = {}, p;
    this.rods.forEach(function (rod) { about[first + rod[0]] = rod; });
    for (var c in still) this.now[+c] = still[c];
    for (p = 0; p < many; p++) this.fixed.push(p in still && (p + many) in still && (p + first - many) in still);
    this.turns = this.moving.map(function (channel) { return about[channel] ? about[channel][4] : 0; });
    this.values = new Float32Array(values.length);
    for (var k = 0; k < values.length; k++) {
      var channel = this.moving[Math.floor(k / this.count)], rod = about[channel];
      this.values[k] = rod ? rod[3] + packed.swing * values[k] / 32767
        : packed.centre[Math.floor(channel / many)] + packed.half * values[k] / 32767;
    }
    // What is traced: the last point that moves; where both ends stand still the middle, a coupler's curve.
    var last = this.fixed.lastIndexOf(false);
    this.closed = !this.strokes && many > 3 && this.fixed[0] && this.fixed[many - 1];
    this.tip = last < 0 ? null : this.closed ? [Math.floor((many - 1) / 2), Math.ceil((many - 1) / 2)] : [last, last];
  }

  // The solids of a robot's bodies: half the sides of their boxes, corners as shares of these, triangles, and of every
  // corner of these a normal, smooth where triangles meet at less than 40 degrees.
  function solids(name) {
    var kept = data[name];
    if (!kept || kept.ready) return kept;
    return data[name] = Object.assign(kept.map(function (entry) {
      var half = entry.slice(3, 6), at = new Int16Array(bytes(entry[6])), faces = new Uint16Array(bytes(entry[7]));
      var corners = new Float32Array(at.length), normals = new Float32Array(3 * faces.length), flat = new Float32Array(faces.length), near = [], k, d;
      for (k = 0; k < at.length; k++) corners[k] = at[k] / 32767 * half[k % 3];
      for (k = 0; k < faces.length; k += 3) {
        var a = 3 * faces[k], b = 3 * faces[k + 1], c = 3 * faces[k + 2], u = [], v = [];
        for (d = 0; d < 3; d++) { u.push(corners[b + d] - corners[a + d]); v.push(corners[c + d] - corners[a + d]); }
        for (d = 0; d < 3; d++) flat[k + d] = u[(d + 1) % 3] * v[(d + 2) % 3] - u[(d + 2) % 3] * v[(d + 1) % 3];
        for (d = 0; d < 3; d++) (near[faces[k + d]] = near[faces[k + d]] || []).push(k);
      }
      for (k = 0; k < faces.length; k++) {
        var own = k - k % 3, sum = [0, 0, 0], size = Math.hypot(flat[own], flat[own + 1], flat[own + 2]);
        near[faces[k]].forEach(function (other) {
          var dot = flat[own] * flat[other] + flat[own + 1] * flat[other + 1] + flat[own + 2] * flat[other + 2];
          if (dot >= 0.77 * size * Math.hypot(flat[other], flat[other + 1], flat[other + 2])) for (d = 0; d < 3; d++) sum[d] += flat[other + d];
        });
        for (d = 0; d < 3; d++) normals[3 * k + d] = sum[d] / (Math.hypot(sum[0], sum[1], sum[2]) || 1);
      }
      return { half: half, corners: corners, faces: faces, normals: normals };
    }), { ready: true });
  }

  // All positions at a time in s: Catmull-Rom between samples, periodic; a hybrid motion waits where it jumps.
  Motion.prototype.at = function (time) {
    var n = this.count, place = (((time / this.span) % 1) + 1) % 1 * n;
    var i = Math.floor(place) % n, u = place - Math.floor(place);
    var a = (i + n - 1) % n, c = (i + 1) % n, d = (i + 2) % n;
    this.broken = this.jumps.has(i);
    if (this.jumps.has(a)) a = i;
    if (this.broken) c = d = i;
    else if (this.jumps.has(c)) d = c;
    var u2 = u * u, u3 = u2 * u;
    var wa = 0.5 * (-u + 2 * u2 - u3), wb = 0.5 * (2 - 5 * u2 + 3 * u3);
    var wc = 0.5 * (u + 4 * u2 - 3 * u3), wd = 0.5 * (u3 - u2);
    for (var m = 0; m < this.moving.length; m++) {
      var o = m * n, v = this.values, turn = this.turns[m];
      this.now[this.moving[m]] = wa * v[o + a] + wb * v[o + i] + wc * v[o + c] + wd * v[o + d] +
        turn * ((c < i ? wc : 0) + (d < i ? wd : 0) - (a > i ? wa : 0));
    }
    for (var k = 0; k < this.rods.length; k++) {
      var rod = this.rods[k], p = rod[0], from = rod[1], angle = this.now[this.dims * this.points + p];
      this.now[p] = this.now[from] + rod[2] * Math.cos(angle);
      this.now[p + this.points] = this.now[from + this.points] + rod[2] * Math.sin(angle);
    }
    return this.now;
  };

  // What is traced over all periods: places, and where it jumps.
  Motion.prototype.traced = function () {
    if (this.line || !this.tip) return this.line;
    var steps = Math.max(240, (this.span > this.period ? 2 : 4) * this.count);
    this.line = [];
    for (var k = 0; k <= steps; k++) {
      var now = this.at(k * this.span / steps), at = [];
      for (var d = 0; d < this.dims; d++) at.push((now[this.tip[0] + d * this.points] + now[this.tip[1] + d * this.points]) / 2);
      this.line.push([at, this.broken]);
    }
    return this.line;
  };

  // A motion on the way from one to another of the same points: at the same share of their periods, rods keep their lengths.
  function between(from, to, share) {
    var now = Object.create(to);
    function mixed(a, b) { return a + share * (b - a); }
    now.line = null;
    now.depth = (from.depth || 0) + 1;
    now.now = new Float32Array(to.now.length);
    now.centre = from.centre.map(function (x, d) { return mixed(x, to.centre[d]); });
    now.spans = from.spans.map(function (x, d) { return mixed(x, to.spans[d]); });
    now.at = function (time) {
      var b = to.at(time), a = from.at(time / to.period * from.period), first = to.dims * to.points, near = {};
      for (var c = 0; c < b.length; c++) {
        var turn = c < first ? 0 : 2 * Math.PI * Math.round((a[c] - b[c]) / (2 * Math.PI));
        now.now[c] = mixed(a[c] - turn, b[c]);
      }
      from.rods.forEach(function (rod) { near[rod[0]] = rod; });
      to.rods.forEach(function (rod) {
        var p = rod[0], other = near[p];
        if (!other || other[1] !== rod[1]) return;
        for (var d = 0; d < 2; d++) now.now[p + d * to.points] = now.now[rod[1] + d * to.points] +
          mixed(other[2], rod[2]) * (d ? Math.sin : Math.cos)(now.now[first + p]);
      });
      now.broken = to.broken || from.broken;
      return now.now;
    };
    return now;
  }

  // One canvas that draws a motion.
  function Scene(canvas, motion) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
    this.motion = motion;
    this.frame = null; // { centre, spans } that several motions share, drawn with a scale bar
    this.landscape = null; // potential energies on a grid; see site/landscape.py
    this.level = null; // the energy of the motion, beyond which it cannot go
    this.trace = true;
    this.turned = [Math.PI / 4, 0.6155]; // about the vertical and upwards, rad: as flat pictures show space
    this.zoom = 1;
    this.width = 0;
  }

  // Another motion, at once or, where `lasting` (ms) is given and both have the same points, by way of what is between.
  Scene.prototype.show = function (motion, lasting) {
    var before = this.on && this.on.depth < 3 ? this.on : this.motion, alike = before && motion && before.points === motion.points && before.dims === motion.dims;
    this.way = lasting && alike && !calm ? { from: before, began: performance.now(), lasting: lasting } : null;
    this.on = null;
    this.motion = motion;
    this.width = 0;
    if (this.held) this.canvas.tabIndex = motion && motion.dims > 2 ? 0 : -1;
  };

  // What moves in space is turned by dragging and by arrow keys; + and - zoom, Home goes back.
  Scene.prototype.handle = function (player) {
    var scene = this, canvas = this.canvas, from = null;
    this.held = true;
    canvas.style.touchAction = "pan-y";
    function space() { return scene.motion && scene.motion.dims > 2; }
    function turn(across, up) {
      scene.turned = [scene.turned[0] + across, Math.max(-1.57, Math.min(1.57, scene.turned[1] + up))];
      scene.width = 0;
      player.stale = true;
    }
    canvas.addEventListener("pointerdown", function (event) {
      if (!space()) return;
      from = [event.clientX, event.clientY];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", function (event) {
      canvas.style.cursor = space() ? (from ? "grabbing" : "grab") : "";
      if (!from) return;
      turn((event.clientX - from[0]) / 120, (event.clientY - from[1]) / 120);
      from = [event.clientX, event.clientY];
    });
    ["pointerup", "pointercancel"].forEach(function (name) { canvas.addEventListener(name, function () { from = null; }); });
    canvas.addEventListener("keydown", function (event) {
      var turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }, step = turns[event.key];
      var zoom = { "+": 1.15, "=": 1.15, "-": 1 / 1.15 }[event.key];
      if (!space() || !(step || zoom || event.key === "Home")) return;
      event.preventDefault();
      if (zoom) scene.zoom *= zoom;
      if (event.key === "Home") { scene.zoom = 1; scene.turned = [Math.PI / 4, 0.6155]; }
      turn.apply(null, step || [0, 0]);
    });
  };

  // Where a place (down, right, to the eye) is on the canvas: px across and down, and how near it is to the eye.
  Scene.prototype.spot = function (at) {
    var c = this.centre, s = this.scale, v = this.view, x = at[0] - c[0], y = at[1] - c[1];
    if (!v) return [this.width / 2 + y * s, this.height / 2 + x * s * this.tall, 0];
    var z = at[2] - c[2];
    return [this.width / 2 + s * (v[1][1] * y + v[1][2] * z), this.height / 2 + s * (v[0][0] * x + v[0][1] * y + v[0][2] * z),
      v[2][0] * x + v[2][1] * y + v[2][2] * z];
  };

  Scene.prototype.fit = function () {
    var ratio = Math.min(window.devicePixelRatio || 1, 2), m = this.motion;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.canvas.width = Math.round(this.width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (!m) return;
    var frame = this.frame || m;
    this.centre = frame.centre;
    this.spans = frame.spans;
    this.scale = 0.84 * Math.min(this.height / frame.spans[0], this.width / frame.spans[1]);
    this.tall = 1;
    if (m.around && m.around.unlike) { // two quantities, each on its own scale
      this.scale = 0.84 * this.width / frame.spans[1];
      this.tall = 0.84 * this.height / frame.spans[0] / this.scale;
    }
    this.view = null;
    if (m.dims > 2) {
      var ca = Math.cos(this.turned[0]), sa = Math.sin(this.turned[0]), ce = Math.cos(this.turned[1]), se = Math.sin(this.turned[1]);
      this.view = [[ce, se * sa, se * ca], [0, ca, -sa], [-se, ce * sa, ce * ca]]; // down, right, to the eye
      var flat = Math.hypot(frame.spans[1], frame.spans[2]); // what it needs however it is turned about the vertical
      this.scale = 0.97 * this.zoom * Math.min(this.height / (ce * frame.spans[0] + Math.abs(se) * flat), this.width / flat);
    }
    this.paths = [];
    this.shadow = null;
    if (!this.way || !this.frame) this.lines = this.landscape && !this.way ? this.equal() : [];
    if (!m.tip) return;
    var far = new Path2D(), near = new Path2D(), floor = new Path2D(), cut = true, last, below, scene = this;
    m.traced().forEach(function (piece) {
      var at = scene.spot(piece[0]), path = at[2] < 0 ? far : near;
      if (!cut) { path.moveTo(last[0], last[1]); path.lineTo(at[0], at[1]); }
      if (scene.view) {
        var foot = scene.spot([scene.centre[0] + frame.spans[0] / 2, piece[0][1], piece[0][2]]);
        if (!cut) { floor.moveTo(below[0], below[1]); floor.lineTo(foot[0], foot[1]); }
        below = foot;
      }
      last = at;
      cut = piece[1]; // the next point is after the jump
    });
    this.paths = this.view ? [far, near] : [near];
    this.shadow = this.view && floor;
  };

  // Lines of equal potential energy: through the triangles of the grid, that of the motion's own energy last.
  Scene.prototype.equal = function () {
    var it = this.landscape, n = it.down.length - 1, scene = this, v = it.values = it.values || new Float32Array(bytes(it.data));
    function place(i, j) { return [scene.width / 2 + (it.right[j] - scene.centre[1]) * scene.scale,
      scene.height / 2 + (it.down[i] - scene.centre[0]) * scene.scale, v[i * (n + 1) + j]]; }
    return it.levels.concat(this.level === null ? [] : [this.level]).map(function (level) {
      var path = new Path2D();
      function triangle(corners) {
        var cuts = [];
        for (var k = 0; k < 3; k++) {
          var a = corners[k], b = corners[(k + 1) % 3], share = (level - a[2]) / (b[2] - a[2]);
          if ((a[2] < level) !== (b[2] < level)) cuts.push([a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]);
        }
        if (cuts.length === 2) { path.moveTo(cuts[0][0], cuts[0][1]); path.lineTo(cuts[1][0], cuts[1][1]); }
      }
      for (var i = 0; i < n; i++) for (var j = 0; j < n; j++) {
        var a = place(i, j), b = place(i, j + 1), c = place(i + 1, j), d = place(i + 1, j + 1);
        triangle([a, b, d]);
        triangle([a, d, c]);
      }
      return path;
    });
  };

  Scene.prototype.release = function () { this.width = 0; this.dots = null; this.canvas.width = this.canvas.height = 0; };
  Scene.prototype.point = function (now, p) {
    var many = this.motion.points;
    return this.spot([now[p], now[p + many], this.view ? now[p + 2 * many] : 0]);
  };
  Scene.prototype.across = function (now, p) { return this.point(now, p)[0]; };
  Scene.prototype.down = function (now, p) { return this.point(now, p)[1]; };
  Scene.prototype.traced = function (now) {
    var near = this.point(now, this.motion.tip[0]), other = this.point(now, this.motion.tip[1]);
    return [(near[0] + other[0]) / 2, (near[1] + other[1]) / 2];
  };

  // In space: the box about the motion, the shadow of its path on the floor, and which way the axes go.
  Scene.prototype.box = function (c) {
    var pen = this.pen, scene = this, half = this.spans.map(function (span) { return span / 2; });
    function corner(k) { return scene.spot(half.map(function (h, d) { return scene.centre[d] + (k >> d & 1 ? h : -h); })); }
    var corners = [0, 1, 2, 3, 4, 5, 6, 7].map(corner), nearest = 0;
    corners.forEach(function (at, k) { if (at[2] > corners[nearest][2]) nearest = k; });
    pen.strokeStyle = pen.fillStyle = c.muted;
    pen.lineWidth = 1;
    pen.globalAlpha = 0.35;
    pen.beginPath();
    for (var k = 0; k < 8; k++) for (var d = 0; d < 3; d++) {
      var other = k | 1 << d;
      if (other === k || k === nearest || other === nearest) continue; // the near edges would lie before the motion
      pen.moveTo(corners[k][0], corners[k][1]);
      pen.lineTo(corners[other][0], corners[other][1]);
    }
    pen.stroke();
    pen.globalAlpha = 0.5;
    if (this.trace && this.shadow) pen.stroke(this.shadow);
    pen.globalAlpha = 1;
    if (this.width < 240) return;
    var zero = this.spot(this.centre), w = this.width, h = this.height, origin = [[w - 42, h - 42], [w - 42, 42], [42, 42]].find(function (at) {
      return !scene.motion.around.marks.some(function (mark) {
        var place = scene.within(scene.spot(mark[1]));
        return Math.hypot(place[0] - at[0], place[1] - at[1]) < 80 && !(place[2] && rests(mark));
      });
    }) || [w - 42, h - 42];
    pen.font = "italic 14px Georgia, serif";
    pen.textAlign = "center";
    this.motion.around.axes.forEach(function (axis) {
      var tip = scene.spot(axis[1].map(function (x, d) { return scene.centre[d] + x / scene.scale; }));
      var way = [tip[0] - zero[0], tip[1] - zero[1]];
      pen.beginPath();
      pen.moveTo(origin[0], origin[1]);
      pen.lineTo(origin[0] + 24 * way[0], origin[1] + 24 * way[1]);
      pen.stroke();
      if (Math.hypot(way[0], way[1]) > 0.2) pen.fillText(axis[0], origin[0] + 33 * way[0], origin[1] + 33 * way[1] + 4);
    });
    pen.textAlign = "start";
  };

  // A place, or where the way to it leaves the picture.
  Scene.prototype.within = function (at) {
    var x = this.width / 2, y = this.height / 2, dx = at[0] - x, dy = at[1] - y;
    var share = Math.min(1, (x - 12) / Math.abs(dx || 1e-9), (y - 12) / Math.abs(dy || 1e-9));
    return [x + share * dx, y + share * dy, share < 1];
  };

  function rests(mark) { return /^L[1-5]$/.test(mark[0]); }

  // What goes across and up, where these are two quantities.
  Scene.prototype.names = function (c) {
    var pen = this.pen, names = this.motion.around.unlike;
    if (this.width < 150) return;
    pen.fillStyle = c.muted;
    pen.font = "13px system-ui, sans-serif";
    pen.fillText(names[1] + " \u2191", 6, 16);
    pen.fillText(names[0] + " \u2192", this.width - pen.measureText(names[0] + " \u2192").width - 6, this.height - 6);
  };

  // What stands about the motion: bodies as discs, at least to be seen, places of rest as crosses; an arrow towards a
  // body beyond the edge.
  Scene.prototype.marks = function (c) {
    var pen = this.pen, scene = this, w = this.width, h = this.height, taken = [];
    if (w < 150) return;
    pen.font = "13px system-ui, sans-serif";
    this.motion.around.marks.forEach(function (mark) {
      var at = scene.within(scene.spot(mark[1])), x = at[0], y = at[1], inside = !at[2], body = !rests(mark);
      if (!inside && !body) return;
      if (taken.some(function (other) { return Math.hypot(other[0] - x, other[1] - y) < 12; })) return;
      taken.push([x, y]);
      pen.strokeStyle = c.muted;
      pen.fillStyle = body ? c.ground : c.muted;
      pen.lineWidth = 1.5;
      pen.beginPath();
      if (!inside) {
        var far = Math.hypot(x - w / 2, y - h / 2), ux = (x - w / 2) / far, uy = (y - h / 2) / far;
        pen.moveTo(x, y);
        pen.lineTo(x - 11 * ux + 5 * uy, y - 11 * uy - 5 * ux);
        pen.lineTo(x - 11 * ux - 5 * uy, y - 11 * uy + 5 * ux);
        pen.fill();
        x -= 14 * ux;
        y -= 14 * uy;
      } else if (body) { pen.arc(x, y, Math.max(4, mark[2] * scene.scale), 0, 7); pen.fill(); }
      else { pen.moveTo(x - 4, y - 4); pen.lineTo(x + 4, y + 4); pen.moveTo(x - 4, y + 4); pen.lineTo(x + 4, y - 4); pen.stroke(); }
      var wide = pen.measureText(mark[0]).width;
      pen.fillStyle = c.ink;
      pen.fillText(mark[0], Math.max(2, Math.min(x + 8 + wide < w ? x + 8 : x - 8 - wide, w - wide - 2)), Math.max(14, Math.min(y - 6, h - 4)));
    });
  };

  // What drifts is seen from beside it: a ruler passes below.
  Scene.prototype.ruler = function (time, c) {
    var pen = this.pen, m = this.motion, step = this.length() * this.scale, y = this.height - 4;
    var gone = (time / m.period * m.drift[1] * this.scale) % step;
    pen.strokeStyle = c.muted;
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(0, y);
    pen.lineTo(this.width, y);
    for (var x = -gone - step; x < this.width; x += step) { pen.moveTo(x, y); pen.lineTo(x, y - 8); }
    pen.stroke();
  };

  // The length of 1, 2 or 5 times a power of ten that is about a sixth of the picture.
  Scene.prototype.length = function () {
    var wanted = this.width / 6 / this.scale, ten = Math.pow(10, Math.floor(Math.log10(wanted)));
    return [5, 2, 1].map(function (k) { return k * ten; }).find(function (x) { return x <= wanted; });
  };

  // That length as a bar, named.
  Scene.prototype.bar = function (unit) {
    var pen = this.pen, long = this.length(), y = this.height - 10, x = 10;
    var c = colours(this.canvas), text = figure(long, 2) + (unit ? " " + unit : "");
    pen.font = "13px system-ui, sans-serif";
    pen.globalAlpha = 0.85; // lines of equal potential end before it
    pen.fillStyle = c.surface;
    pen.fillRect(0, y - 24, Math.max(long * this.scale, pen.measureText(text).width) + 2 * x, 34);
    pen.globalAlpha = 1;
    pen.strokeStyle = pen.fillStyle = c.muted;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(x + long * this.scale, y);
    pen.stroke();
    pen.fillText(text, x, y - 6);
  };

  Scene.prototype.draw = function (time) {
    var way = this.way, to = this.motion, share = way && (performance.now() - way.began) / way.lasting;
    if (!way) return this.paint(time);
    this.way = share < 1 ? way : null;
    this.motion = share < 1 ? between(way.from, to, share) : to;
    this.fit();
    this.paint(time);
    this.on = share < 1 ? this.motion : null; // from where the next one goes on
    this.motion = to;
    this.player.stale = true;
  };

  Scene.prototype.paint = function (time) {
    if (this.canvas.clientWidth !== this.width) this.fit();
    var pen = this.pen, m = this.motion, c = colours(this.canvas);
    pen.clearRect(0, 0, this.width, this.height);
    if (!m || !this.width) return;
    var small = Math.min(this.width, this.height), many = m.points > 20, line = Math.max(1.5, small / (many ? 130 : 75));
    pen.lineCap = pen.lineJoin = "round";
    (this.lines || []).forEach(function (path, k, all) {
      var own = this.level !== null && k === all.length - 1;
      pen.strokeStyle = c.muted;
      pen.lineWidth = own ? 1.8 : 1;
      pen.globalAlpha = own ? 1 : 0.4;
      pen.stroke(path);
      pen.globalAlpha = 1;
    }, this);
    if (this.view) this.box(c);
    if (m.around) this.marks(c);
    if (m.ground) this.floor(time, line);
    if (m.drift) this.ruler(time, c);
    if (this.trace && this.paths.length) {
      pen.strokeStyle = c.trace;
      pen.lineWidth = Math.max(1, line * 0.35);
      this.paths.forEach(function (path, k, all) {
        pen.globalAlpha = all.length < 2 ? 0.35 : k ? 0.6 : 0.25; // near to the eye it is stronger
        pen.stroke(path);
      });
      pen.globalAlpha = 1;
      this.tail(time, line);
    }
    if (m.around && m.around.unlike) this.names(c);
    else if (this.frame) this.bar(this.frame.unit);
    else if (this.view && this.width >= 240 && m.around.unit !== null) this.bar(m.around.unit);
    if (this.beside) this.ghost(time, line);
    var now = m.at(time), p;
    if (m.strokes) { this.mechanism(now, line); return; }
    if (m.closed) { // the link that stands still
      pen.strokeStyle = c.muted;
      pen.lineWidth = line * 0.5;
      pen.setLineDash([line, 1.6 * line]);
      pen.beginPath();
      pen.moveTo(this.across(now, 0), this.down(now, 0));
      pen.lineTo(this.across(now, m.points - 1), this.down(now, m.points - 1));
      pen.stroke();
      pen.setLineDash([]);
    }
    pen.strokeStyle = c.link;
    pen.lineWidth = line;
    pen.beginPath();
    for (p = 0; p < m.points; p++) pen.lineTo(this.across(now, p), this.down(now, p));
    pen.stroke();
    for (p = 0; p < m.points; p++) {
      var x = this.across(now, p), y = this.down(now, p), r = line * (m.points === 1 ? 1.6 : 1.1);
      pen.fillStyle = m.fixed[p] ? c.ground : c.joint;
      if (m.fixed[p]) { pen.fillRect(x - r, y - r, 2 * r, 2 * r); continue; }
      if (many && p !== m.points - 1) continue;
      pen.beginPath();
      pen.arc(x, y, r, 0, 2 * Math.PI);
      pen.fill();
    }
  };

  // Another motion behind this one, in grey: its lines alone.
  Scene.prototype.ghost = function (time, line) {
    var pen = this.pen, scene = this, m = this.beside, now = m.at(time), all = [];
    for (var p = 0; p < m.points; p++) all.push(p);
    var lines = m.strokes ? m.strokes.map(function (stroke) { return /disc|solid/.test(stroke[0]) ? [] : stroke[1]; }) : [all];
    pen.strokeStyle = pen.fillStyle = colours(this.canvas).muted;
    pen.lineWidth = line * 0.7;
    pen.globalAlpha = 0.6;
    lines.forEach(function (line) {
      pen.beginPath();
      line.forEach(function (p) { pen.lineTo(scene.across(now, p), scene.down(now, p)); });
      pen.stroke();
    });
    if (m.tip) {
      pen.beginPath();
      pen.arc(this.across(now, m.tip[0]), this.down(now, m.tip[0]), line * 1.1, 0, 2 * Math.PI);
      pen.fill();
    }
    pen.globalAlpha = 1;
  };

  // Solids, lit from above the left shoulder: what is nearer to the eye hides the rest, dot by dot.
  var sheet = document.createElement("canvas");
  Scene.prototype.solid = function (now, kept) {
    var scene = this, fine = 2, wide = Math.ceil(fine * this.width), high = Math.ceil(fine * this.height), m = this.motion, c = colours(this.canvas), pen = sheet.getContext("2d");
    if (!this.dots || this.dots.width !== wide || this.dots.height !== high) {
      this.dots = new ImageData(wide, high);
      this.depths = new Float32Array(wide * high);
    }
    var dots = new Uint32Array(this.dots.data.buffer), depths = this.depths, box = [wide, high, 0, 0], x = [], y = [], z = [], light = [], number = 0;
    dots.fill(0);
    depths.fill(-Infinity);
    function shades(colour, paler) {
      pen.fillStyle = colour;
      var hex = parseInt(pen.fillStyle.slice(1), 16), table = new Uint32Array(256);
      for (var k = 0; k < 256; k++) {
        for (var d = 0, value = 0; d < 3; d++) {
          var full = hex >> 8 * (2 - d) & 255, base = full + paler * (255 - full);
          value = value * 256 + Math.round(k < 190 ? base * (0.4 + 0.6 * k / 190) : base + (255 - base) * (k - 190) / 130);
        }
        table[k] = (255 << 24 | (value & 255) << 16 | (value >> 8 & 255) << 8 | value >> 16 & 255) >>> 0;
      }
      return table;
    }
    function fill(table) {
      var order = [0, 1, 2].sort(function (i, j) { return y[i] - y[j]; }), a = order[0], b = order[1], e = order[2];
      var area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
      if (Math.abs(area) < 1e-6) return;
      function slope(of) { return [((of[1] - of[0]) * (y[2] - y[0]) - (of[2] - of[0]) * (y[1] - y[0])) / area, ((of[2] - of[0]) * (x[1] - x[0]) - (of[1] - of[0]) * (x[2] - x[0])) / area]; }
      var zs = slope(z), ls = slope(light), from = Math.max(0, Math.ceil(y[a])), to = Math.min(high - 1, Math.floor(y[e]));
      for (var row = from; row <= to; row++) {
        var long = x[a] + (x[e] - x[a]) * (row - y[a]) / (y[e] - y[a]);
        var short = row < y[b] ? x[a] + (x[b] - x[a]) * (row - y[a]) / (y[b] - y[a]) : y[e] > y[b] ? x[b] + (x[e] - x[b]) * (row - y[b]) / (y[e] - y[b]) : x[b];
        var left = Math.max(0, Math.ceil(Math.min(long, short))), right = Math.min(wide - 1, Math.floor(Math.max(long, short)));
        var depth = z[0] + (left - x[0]) * zs[0] + (row - y[0]) * zs[1], shade = light[0] + (left - x[0]) * ls[0] + (row - y[0]) * ls[1];
        for (var k = row * wide + left, end = k + right - left; k <= end; k++, depth += zs[0], shade += ls[0]) {
          if (depth > depths[k]) { depths[k] = depth; dots[k] = table[shade < 0 ? 0 : shade > 255 ? 255 : shade | 0]; }
        }
        if (left <= right) box = [Math.min(box[0], left), Math.min(box[1], row), Math.max(box[2], right + 1), Math.max(box[3], row + 1)];
      }
    }
    m.strokes.forEach(function (stroke) {
      if (stroke[0] !== "solid" || !kept[number]) return;
      var solid = kept[number++], at = stroke[1].map(function (p) { return scene.point(now, p); }), origin = at[0];
      var ways = at.slice(1).map(function (side, d) { return side.map(function (value, i) { return (value - origin[i]) * (i < 2 ? fine : fine * scene.scale) / solid.half[d]; }); });
      var still = stroke[1].every(function (p) { return m.fixed[p]; }), table = shades(still ? c.ground : c.link, still ? 0.2 : number % 2 ? 0 : 0.35);
      var many = solid.corners.length / 3, placed = new Float32Array(3 * many), n = solid.normals, f = solid.faces, k, i, d;
      for (k = 0; k < many; k++) for (i = 0; i < 3; i++) {
        for (d = 0, placed[3 * k + i] = origin[i] * (i < 2 ? fine : fine * scene.scale); d < 3; d++) placed[3 * k + i] += solid.corners[3 * k + d] * ways[d][i];
      }
      var unit = 1 / (fine * scene.scale), sun = ways.map(function (way) { return unit * (-0.42 * way[0] - 0.56 * way[1] + 0.714 * way[2]); });
      for (k = 0; k < f.length; k += 3) {
        for (i = 0; i < 3; i++) { x[i] = placed[3 * f[k + i]]; y[i] = placed[3 * f[k + i] + 1]; z[i] = placed[3 * f[k + i] + 2]; }
        var side = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]) > 0 ? -1 : 1; // seen from inside
        for (i = 0; i < 3; i++) light[i] = 60 + 195 * Math.max(0, side * (sun[0] * n[3 * (k + i)] + sun[1] * n[3 * (k + i) + 1] + sun[2] * n[3 * (k + i) + 2]));
        fill(table);
      }
    });
    if (box[2] <= box[0]) return;
    var w = box[2] - box[0], h = box[3] - box[1];
    if (sheet.width < wide || sheet.height < high) { sheet.width = Math.max(sheet.width, wide); sheet.height = Math.max(sheet.height, high); }
    pen.putImageData(this.dots, 0, 0, box[0], box[1], w, h);
    this.pen.drawImage(sheet, box[0], box[1], w, h, box[0] / fine, box[1] / fine, w / fine, h / fine);
  };

  // Rods with pins at their ends, springs and discs as thin lines, sliders and the ground filled.
  Scene.prototype.mechanism = function (now, line) {
    var pen = this.pen, scene = this, c = colours(this.canvas), r = line * 0.9, kept = this.view && this.motion.around.solids && solids(this.motion.around.solids);
    if (kept) this.solid(now, kept);
    this.motion.strokes.forEach(function (stroke) {
      if (stroke[0] === "solid" || (kept && /bone|ground|slider/.test(stroke[0]))) return;
      var kind = stroke[0], at = stroke[1].map(function (p) { return scene.point(now, p); });
      var x = at[0][0], y = at[0][1], far = at[at.length - 1], dx = far[0] - x, dy = far[1] - y;
      pen.lineWidth = kind === "rod" || kind === "bone" ? line : line * 0.5;
      pen.strokeStyle = kind === "spring" ? c.muted : kind === "ground" ? c.ground : c.link;
      pen.fillStyle = kind === "ground" ? c.ground : c.joint;
      pen.beginPath();
      if (kind === "slider") { pen.fillRect(x - 2.4 * r, y - 1.5 * r, 4.8 * r, 3 * r); return; }
      if (kind === "disc" && at.length > 2) { // as it is seen in space, with the way to the rim
        pen.moveTo(x, y);
        for (var turn = 0; turn <= 40; turn++) {
          var u = Math.cos(turn * Math.PI / 20), v = Math.sin(turn * Math.PI / 20);
          pen.lineTo(x + u * (at[1][0] - x) + v * dx, y + u * (at[1][1] - y) + v * dy);
        }
      } else if (kind === "disc") pen.arc(x, y, Math.hypot(dx, dy), 0, 2 * Math.PI);
      else if (kind === "ground") { pen.moveTo(x, y); pen.lineTo(x - 2 * r, y + 3 * r); pen.lineTo(x + 2 * r, y + 3 * r); pen.fill(); }
      else if (kind === "spring") {
        var long = Math.hypot(dx, dy) || 1, coils = 16;
        pen.moveTo(x, y);
        for (var k = 0; k <= coils; k++) {
          var share = 0.15 + 0.7 * k / coils, side = k && k < coils ? (k % 2 ? 2 : -2) * r / long : 0;
          pen.lineTo(x + share * dx - side * dy, y + share * dy + side * dx);
        }
        pen.lineTo(far[0], far[1]);
      } else at.forEach(function (p) { pen.lineTo(p[0], p[1]); });
      pen.stroke();
      if (kind === "rod" || kind === "bone") at.forEach(function (p) {
        pen.beginPath();
        pen.arc(p[0], p[1], at.length === 1 ? 1.6 * line : 0.7 * r, 0, 2 * Math.PI); // a mass in a point, or a pin
        pen.fill();
      });
    });
  };

  // What the machine stands on or hits, [down, right] in m.
  Scene.prototype.floor = function (time, line) {
    var pen = this.pen, m = this.motion, all = m.ground, place = ((time / m.period) % 1 + 1) % 1;
    var piece = all[Math.floor(place * all.length) % all.length];
    pen.strokeStyle = colours(this.canvas).muted;
    pen.lineWidth = line * 0.5;
    pen.beginPath();
    for (var k = 0; k < piece[0].length; k++) {
      pen.lineTo(this.width / 2 + (piece[1][k] - this.centre[1]) * this.scale,
        this.height / 2 + (piece[0][k] - this.centre[0]) * this.scale);
    }
    pen.stroke();
  };

  // The last quarter period of the tip's path, fading away from it.
  Scene.prototype.tail = function (time, line) {
    var pen = this.pen, m = this.motion, parts = 4, steps = Math.max(12, Math.round(m.count / 12)), span = m.period / 4;
    pen.strokeStyle = colours(this.canvas).trace;
    pen.lineWidth = line * 0.6;
    for (var part = 0; part < parts; part++) {
      pen.globalAlpha = (part + 1) / parts;
      pen.beginPath();
      for (var k = 0, cut = true; k <= steps; k++) {
        var at = this.traced(m.at(time - span * (1 - (part + k / steps) / parts)));
        if (cut) pen.moveTo(at[0], at[1]);
        else pen.lineTo(at[0], at[1]);
        cut = m.broken;
      }
      pen.stroke();
    }
    pen.globalAlpha = 1;
  };

  // The palette of a page, or of what a scene stands in; read once a theme.
  var known = new Map();
  function colours(element) {
    var from = element || document.documentElement;
    if (known.has(from)) return known.get(from);
    var style = getComputedStyle(from);
    function read(name) { return style.getPropertyValue("--" + name).trim(); }
    var found = { link: read("link"), joint: read("joint"), trace: read("trace"), ground: read("ground"), ink: read("ink"),
      muted: read("muted"), line: read("line"), surface: read("surface"),
      series: ["s1", "s2", "s3", "s4", "s5", "s6"].map(read) };
    known.set(from, found);
    return found;
  }

  // Only scenes on the screen are drawn; `follow` gets the time whenever it changes.
  function Player() {
    var self = this;
    this.time = 0;
    this.speed = 1;
    this.playing = !calm;
    this.frames = 0;
    this.cost = 0;
    this.scenes = [];
    this.visible = new Set();
    this.followers = [];
    this.stale = true;
    this.watcher = new IntersectionObserver(function (changes) {
      changes.forEach(function (change) {
        var scene = change.target.scene;
        if (change.isIntersecting) self.visible.add(scene);
        else { self.visible.delete(scene); scene.release(); }
      });
      self.stale = true;
    }, { rootMargin: "60px" });
    var last = null;
    function tick(moment) {
      var passed = last === null ? 0 : Math.min(0.1, (moment - last) / 1000), began;
      last = moment;
      if (self.closed) return;
      if (self.playing) self.time += passed * self.speed;
      if (self.playing || self.stale) {
        began = performance.now();
        self.stale = false;
        self.visible.forEach(function (scene) { scene.draw(self.time); });
        self.followers.forEach(function (follow) { follow(self.time); });
        self.frames++;
        self.cost += performance.now() - began;
      }
      requestAnimationFrame(tick);
    }
    requestAnimationFrame(tick);
    function refresh() { known.clear(); self.stale = true; self.scenes.forEach(function (scene) { scene.width = 0; }); }
    document.addEventListener("orbitfinder-theme", refresh);
    window.addEventListener("resize", refresh);
    this.close = function () {
      self.closed = true;
      self.watcher.disconnect();
      document.removeEventListener("orbitfinder-theme", refresh);
      window.removeEventListener("resize", refresh);
      self.scenes.forEach(function (scene) { known.delete(scene.canvas); });
    };
  }

  Player.prototype.add = function (canvas, motion) {
    var scene = new Scene(canvas, motion);
    canvas.scene = scene;
    scene.player = this;
    this.scenes.push(scene);
    if (!canvas.dataset.motion) scene.handle(this); // of the gallery's cards all is a link
    scene.show(motion);
    this.watcher.observe(canvas);
    return scene;
  };

  Player.prototype.seek = function (time) { this.time = time; this.stale = true; };

  // From a period to another: the same share of it goes on, so that along a family the shape changes and not the instant.
  Player.prototype.turn = function (from, to) { this.seek(from ? (this.time / from - Math.floor(this.time / from)) * to : 0); };

  // The play button, speed and trace that every page has.
  Player.prototype.controls = function () {
    var self = this, button = document.getElementById("play"), speed = document.getElementById("speed");
    var trace = document.getElementById("trace");
    function label() { button.textContent = self.playing ? "Pause" : "Play"; }
    button.addEventListener("click", function () { self.playing = !self.playing; label(); });
    speed.addEventListener("change", function () { self.speed = +speed.value; });
    trace.addEventListener("change", function () {
      self.scenes.forEach(function (scene) { scene.trace = trace.checked; });
      self.stale = true;
    });
    self.speed = +speed.value;
    self.scenes.forEach(function (scene) { scene.trace = trace.checked; });
    label();
  };

  // The slider and clock of a page with one orbit; `period` is asked for anew, since the orbit may change; `unit` of times.
  Player.prototype.scrubber = function (period, unit) {
    var self = this, slider = document.getElementById("time"), clock = document.getElementById("clock");
    slider.addEventListener("input", function () {
      self.playing = false;
      document.getElementById("play").textContent = "Play";
      self.seek(+slider.value / 1000 * period());
    });
    self.followers.push(function (time) {
      var whole = period(), within = whole ? time - whole * Math.floor(time / whole) : 0;
      if (document.activeElement !== slider || self.playing) slider.value = Math.round(1000 * within / whole);
      clock.textContent = within.toFixed(2) + (unit ? " " + unit : "");
      slider.setAttribute("aria-valuetext", clock.textContent);
    });
  };

  function save(name, type, text) {
    var link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: type }));
    link.download = name;
    link.click();
    setTimeout(function () { URL.revokeObjectURL(link.href); }, 1000);
  }

  function figure(value, digits) {
    if (value === null || value === undefined || !isFinite(value)) return "not computed";
    var size = Math.abs(value), text;
    if (value !== 0 && (size < 1e-4 || size >= 1e7)) text = value.toExponential(Math.max(0, (digits || 6) - 3));
    else text = String(+value.toPrecision(digits || 6));
    return text.replace(/-/g, "\u2212");
  }

  return { put: put, data: data, bytes: bytes, Motion: Motion, Player: Player, colours: colours, save: save,
    figure: figure, calm: calm };
})();
