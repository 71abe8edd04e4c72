// The gallery: every card moves while it is on the screen; sorting and filtering rearrange the list.
(function () {
  "use strict";
  var motions = orbitfinder.data.gallery, player = new orbitfinder.Player();
  orbitfinder.player = player;
  document.querySelectorAll("canvas[data-motion]").forEach(function (canvas) {
    var packed = motions[canvas.dataset.motion];
    if (packed) player.add(canvas, new orbitfinder.Motion(packed));
    else canvas.classList.add("empty");
  });
  player.controls();
  var list = document.getElementById("cards"), cards = Array.from(list.children), given = cards.slice();
  function field(id) { return document.getElementById(id); }
  var words = ["mechanism", "stability", "symmetry"], numbers = ["energy", "period"];
  var descending = false, order = field("order");

  // Lower case without accents, as the words of cards are.
  function wanted() { return field("search").value.toLowerCase().normalize("NFKD").replace(/[\u0300-\u036f]/g, "").split(/\s+/).filter(Boolean); }
  function says(node) { return wanted().every(function (word) { return node.dataset.words.indexOf(word) >= 0; }); }
  function passes(card) {
    var about = card.dataset;
    if (!says(card)) return false;
    if (words.some(function (word) { return field(word).value && field(word).value !== about[word]; })) return false;
    return numbers.every(function (name) {
      var low = field(name + "-min").value, high = field(name + "-max").value, value = +about[name];
      return (low === "" || value >= +low) && (high === "" || value <= +high);
    });
  }

  function compare(key) {
    var numeric = numbers.indexOf(key) >= 0 || key === "largest";
    return function (a, b) {
      var one = a.dataset[key], two = b.dataset[key];
      return numeric ? one - two : one.localeCompare(two);
    };
  }

  function arrange() {
    var key = field("sort").value, group = key === "given" || field("group").value !== "collection" ? field("group").value : "", count = 0, sets = new Map();
    cards = given.slice();
    if (key !== "given") cards.sort(compare(key));
    if (descending) cards.reverse();
    list.querySelectorAll(".group").forEach(function (one) { one.remove(); });
    cards.forEach(function (card) {
      var shown = passes(card), name = group ? card.dataset[group] : "";
      card.hidden = !shown;
      count += shown;
      if (!sets.has(name)) sets.set(name, []);
      sets.get(name).push(card);
    });
    sets.forEach(function (some, name) {
      var shown = some.filter(function (card) { return !card.hidden; }).length;
      if (group && shown && sets.size > 1) {
        var head = document.createElement("li");
        head.className = "group";
        head.textContent = (name === "none" ? "no symmetry" : name.replace(/\+/g, " and ")) + " (" + shown + ")";
        list.appendChild(head);
      }
      some.forEach(function (card) { list.appendChild(card); });
    });
    document.querySelectorAll("#links > li").forEach(function (one) { one.hidden = !says(one); });
    field("count").textContent = count === given.length ? count + " orbits" : count + " of " + given.length + " orbits";
    field("nothing").hidden = count > 0;
    player.stale = true;
  }

  field("controls").addEventListener("input", arrange);
  field("finder").addEventListener("input", arrange);
  ["controls", "finder"].forEach(function (id) {
    field(id).addEventListener("submit", function (event) { event.preventDefault(); });
  });
  field("controls").addEventListener("reset", function () {
    descending = false;
    field("finder").reset();
    order.setAttribute("aria-pressed", "false");
    setTimeout(arrange, 0);
  });
  order.addEventListener("click", function () {
    descending = !descending;
    order.setAttribute("aria-pressed", String(descending));
    arrange();
  });
  arrange();
  addEventListener("pageshow", arrange); // coming back the browser fills the form in again
})();
