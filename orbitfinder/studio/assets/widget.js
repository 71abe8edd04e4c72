// The stage in a notebook: the player of the pages in an element of the host, with its colours.
function render({ model, el }) {
  var it = model.get("shown"), items = it.items, many = items.length > 1, player = new orbitfinder.Player(), picked = -1;
  for (var name in it.solids) orbitfinder.put(name, it.solids[name]);
  function make(tag, kind, into) {
    var one = document.createElement(tag);
    if (kind) one.className = kind;
    if (into) into.append(one);
    return one;
  }
  var root = make("div", "orbitfinder", el), head = make("div", "of-head", root);
  make("b", "", head).textContent = it.title;
  if (it.below) make("div", "", head).textContent = it.below;
  var row = make("div", "of-row", root), canvas = make("canvas", "", make("div", "of-stage", row));
  var diagram = it.diagram ? make("div", "of-diagram", row) : null, portrait = make("div", ""), circle = make("div", ""), table = make("table", "of-table");
  if (!diagram) row.append(portrait);
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "the motion of " + it.title);
  function aspect() {
    var spans = it.frame ? it.frame.spans : items[0].motion ? items[0].motion.spans : [1, 1];
    canvas.parentNode.hidden = !items.some(function (one) { return one.motion; });
    canvas.style.aspectRatio = spans.length > 2 ? 1.1 : Math.min(1.8, Math.max(0.8, spans[1] / Math.max(spans[0], 1e-9)));
  }
  aspect();

  // A slider with its name and what it says.
  function slider(name, most) {
    var bar = make("div", "of-bar", root), label = make("label", "", bar), input = make("input", "", bar);
    input.type = "range";
    input.min = 0;
    input.max = most;
    input.setAttribute("aria-label", label.textContent = name);
    return { input: input, bar: bar, label: label, said: make("span", "of-said", bar) };
  }
  var along = many ? slider("along the family", items.length - 1) : null, clock = slider("time", 1000);
  var play = document.createElement("button"), speed = document.createElement("select");
  clock.label.replaceWith(play);
  clock.bar.append(speed);
  [[0.1, "a tenth"], [0.25, "a quarter"], [1, "real time"], [4, "4 times"]].forEach(function (one) {
    speed.add(new Option(one[1], one[0]));
  });
  speed.setAttribute("aria-label", "speed");
  var below = make("div", "of-row", root), marker = null;
  below.append.apply(below, (diagram ? [portrait] : []).concat([circle, table]));
  if (diagram) {
    diagram.innerHTML = it.diagram;
    marker = document.createElementNS("http://www.w3.org/2000/svg", "circle");
    [["r", 8], ["fill", "none"], ["stroke", "currentColor"], ["stroke-width", 2]].forEach(function (one) {
      marker.setAttribute(one[0], one[1]);
    });
    diagram.firstChild.append(marker);
  }

  var scene = player.add(canvas, null);
  if (it.frame) scene.frame = it.frame;
  function pick(k) {
    if (k === picked || !items[k]) return;
    var one = items[k], from = picked < 0 ? 0 : items[picked].period;
    picked = k;
    scene.show(one.motion ? new orbitfinder.Motion(one.motion) : null);
    player.turn(from, one.period);
    portrait.innerHTML = one.portrait;
    if (portrait.firstChild) portrait.firstChild.pauseAnimations();
    circle.innerHTML = one.circle;
    table.replaceChildren.apply(table, one.rows.map(function (pair) {
      var line = document.createElement("tr");
      make("th", "", line).textContent = pair[0];
      make("td", "", line).textContent = pair[1];
      return line;
    }));
    if (!many) return;
    along.input.value = k;
    along.said.textContent = k + 1 + " of " + items.length + (one.label ? ", " + one.label : "");
    along.input.setAttribute("aria-valuetext", along.said.textContent);
    marker.setAttribute("cx", one.place[0]);
    marker.setAttribute("cy", one.place[1]);
  }
  function choose(k) { pick(k); model.set("index", k); model.save_changes(); }
  if (many) along.input.addEventListener("input", function () { choose(+along.input.value); });
  if (diagram) diagram.addEventListener("click", function (event) {
    var svg = diagram.firstChild, at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    function far(one) { return Math.hypot(one.place[0] - at.x, one.place[1] - at.y); }
    choose(items.reduce(function (best, one, k) { return far(one) < far(items[best]) ? k : best; }, 0));
  });

  function told() {
    player.playing = model.get("playing") && !orbitfinder.calm;
    player.speed = model.get("speed");
    speed.value = player.speed;
    player.stale = true;
    label();
  }
  function label() { play.textContent = player.playing ? "Pause" : "Play"; }
  function run(on) {
    player.playing = on;
    label();
    model.set("playing", on);
    model.save_changes();
  }
  play.addEventListener("click", function () { run(!player.playing); });
  speed.addEventListener("change", function () { player.speed = +speed.value; model.set("speed", player.speed); model.save_changes(); });
  clock.input.addEventListener("input", function () { run(false); player.seek(+clock.input.value / 1000 * items[picked].period); });
  player.followers.push(function (time) {
    var period = items[picked].period, within = time - period * Math.floor(time / period);
    if (player.playing || clock.input.getRootNode().activeElement !== clock.input) clock.input.value = 1000 * within / period;
    clock.said.textContent = within.toFixed(2) + (it.time ? " " + it.time : "");
    clock.input.setAttribute("aria-valuetext", clock.said.textContent);
    if (portrait.firstChild) portrait.firstChild.setCurrentTime(within);
  });

  // Dark where the host's text is light.
  function dress() {
    var rgb = (getComputedStyle(root).color.match(/[\d.]+/g) || [0, 0, 0]).map(Number);
    var theme = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2] > 127 ? "dark" : "light";
    if (root.dataset.theme === theme) return;
    root.dataset.theme = theme;
    document.dispatchEvent(new Event("orbitfinder-theme"));
  }
  function redress() { dress(); setTimeout(dress, 400); }
  var host = new MutationObserver(redress), system = matchMedia("(prefers-color-scheme: dark)");
  [document.documentElement, document.body].forEach(function (one) { host.observe(one, { attributes: true }); });
  system.addEventListener("change", redress);
  requestAnimationFrame(redress);

  function turned() { pick(model.get("index")); }
  model.on("change:index", turned);
  model.on("change:playing", told);
  model.on("change:speed", told);
  told();
  turned();
  el.orbitfinder = { player: player, scene: scene, picked: function () { return picked; } };
  return function () {
    player.close();
    host.disconnect();
    system.removeEventListener("change", redress);
    model.off("change:index", turned);
    model.off("change:playing", told);
    model.off("change:speed", told);
  };
}
export default { render };
