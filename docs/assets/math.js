// Typesets what pymdownx.arithmatex has marked, \(...\) within a line and \[...\] displayed.
for (const place of document.querySelectorAll(".arithmatex")) {
  const text = place.textContent;
  katex.render(text.slice(2, -2), place, { displayMode: text.startsWith("\\["), throwOnError: false });
}
