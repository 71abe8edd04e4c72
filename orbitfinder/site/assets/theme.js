// The theme is set before anything is drawn, so that no page flashes in the wrong one.
(function () {
  "use strict";
  var root = document.documentElement, key = "orbitfinder-theme";
  function stored() { try { return localStorage.getItem(key); } catch (error) { return null; } }
  function show(choice) {
    if (choice === "light" || choice === "dark") root.setAttribute("data-theme", choice);
    else root.removeAttribute("data-theme");
  }
  show(stored());
  document.addEventListener("DOMContentLoaded", function () {
    var button = document.getElementById("theme"), order = ["system", "light", "dark"];
    var current = order.indexOf(stored() || "system");
    function label() { button.textContent = "Theme: " + order[current]; }
    current = Math.max(0, current);
    label();
    button.addEventListener("click", function () {
      current = (current + 1) % order.length;
      show(order[current]);
      try { localStorage.setItem(key, order[current]); } catch (error) { /* opened where nothing can be stored */ }
      label();
      document.dispatchEvent(new Event("orbitfinder-theme"));
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", function () {
      document.dispatchEvent(new Event("orbitfinder-theme"));
    });
  });
})();
