// Questions that tests/test_page_browser.py asks of a page.
const checks = {
  // A number that changes when a canvas is drawn differently.
  picture(selector) {
    const c = document.querySelector(selector), data = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
    return data.reduce((sum, value, i) => (sum * 31 + value * (i % 97)) % 1e9, 7);
  },

  // Contrast ratio (WCAG 2) and name of every element with text of its own, in SVG too.
  texts() {
    const parse = text => { const m = text.match(/[\d.]+/g).map(Number); return m.length > 3 ? m : [...m, 1]; };
    const light = c => c.slice(0, 3).map(v => v / 255)
      .map(v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
      .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
    const behind = node => {
      for (; node; node = node.parentElement) {
        const c = parse(getComputedStyle(node).backgroundColor);
        if (c[3] > 0.99) return c;
      }
      return [255, 255, 255, 1];
    };
    const out = [];
    for (const node of document.querySelectorAll("body *")) {
      const own = Array.from(node.childNodes).some(n => n.nodeType === 3 && n.data.trim());
      const box = node.getBoundingClientRect(), style = getComputedStyle(node);
      if (!own || !box.width || style.visibility === "hidden" || node.closest("option, noscript, .skip")) continue;
      const svg = node.closest("svg"), ink = parse(svg ? style.fill : style.color);
      const [a, b] = [light(ink), light(behind(svg ? svg.parentElement : node))].sort((x, y) => y - x);
      out.push([(a + 0.05) / (b + 0.05), `${node.tagName}.${node.getAttribute("class")}: ${node.textContent.slice(0, 40)}`]);
    }
    return out;
  },

  // What sticks out of the page, or out of <main> without a scrolling box around it.
  overflow() {
    const wide = document.documentElement.scrollWidth - innerWidth, out = wide > 0 ? [`page by ${wide}`] : [];
    const main = document.querySelector("main").getBoundingClientRect();
    for (const node of document.querySelectorAll("main *")) {
      if (node.closest(".scroll, pre, svg, .plot, details:not([open])")) continue;
      const box = node.getBoundingClientRect();
      if (box.width && (box.right > main.right + 1 || box.left < main.left - 1)) out.push(node.outerHTML.slice(0, 90));
    }
    return out;
  },

  // Controls, pictures and regions without an accessible name.
  nameless() {
    const words = id => (document.getElementById(id) || {}).textContent || "";
    const name = node => node.getAttribute("aria-label") || node.getAttribute("alt") || node.textContent.trim() ||
      (node.getAttribute("aria-labelledby") || "").split(" ").map(words).join("") ||
      Array.from(node.labels || []).map(label => label.textContent).join("");
    const kinds = "button, a, input, select, canvas, img, section, [role=img], [role=region], [role=group]";
    return Array.from(document.querySelectorAll(kinds))
      .filter(node => !node.closest("[aria-hidden=true]") && !name(node)).map(node => node.outerHTML.slice(0, 90));
  },

  // Where on the screen point `index` (-1: the last) of the first pickable trace is, and its x.
  place(index) {
    const div = document.getElementById("plot"), full = div._fullLayout;
    div.scrollIntoView({ block: "center" });
    const trace = div.data.find(one => one.customdata && one.customdata.length), box = div.getBoundingClientRect();
    const k = index < 0 ? trace.x.length - 1 : index, x = full.xaxis, y = full.yaxis;
    return [box.left + x._offset + x.d2p(trace.x[k]), box.top + y._offset + y.d2p(trace.y[k]), trace.x[k]];
  },

  // Where on the screen a time is on the plot of the coordinates.
  instant(time) {
    const div = document.getElementById("coordinates"), full = div._fullLayout;
    div.scrollIntoView({ block: "center" });
    const box = div.getBoundingClientRect();
    return [box.left + full.xaxis._offset + full.xaxis.l2p(time), box.top + full.yaxis._offset + full.yaxis._length / 2];
  },
};
