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
  if (matchMedia("(max-width: 520px)").matches) document.getElementById("filters").open = false;

  var list = document.getElementById("cards"), cards = Array.from(list.children), given = cards.slice();
  function field(id) { return document.getElementById(id); }
  var words = ["mechanism", "stability", "symmetry"], numbers = ["energy", "period"];
  var descending = false, order = field("order");

  function passes(card) {
    var about = card.dataset, text = field("search").value.trim().toLowerCase();
    if (text && (about.title + " " + about.slug + " " + about.series).toLowerCase().indexOf(text) < 0) return false;
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
    var key = field("sort").value, count = 0;
    cards = given.slice();
    if (key !== "given") cards.sort(compare(key));
    if (descending) cards.reverse();
    cards.forEach(function (card) {
      var shown = passes(card);
      card.hidden = !shown;
      count += shown;
      list.appendChild(card);
    });
    field("count").textContent = count === given.length ? count + " orbits" : count + " of " + given.length + " orbits";
    field("nothing").hidden = count > 0;
    player.stale = true;
  }

  field("controls").addEventListener("input", arrange);
  field("controls").addEventListener("submit", function (event) { event.preventDefault(); });
  field("controls").addEventListener("reset", function () {
    descending = false;
    order.setAttribute("aria-pressed", "false");
    setTimeout(arrange, 0);
  });
  order.addEventListener("click", function () {
    descending = !descending;
    order.setAttribute("aria-pressed", String(descending));
    arrange();
  });
  arrange();
})();
