// On a narrow screen docs/pages.css shows each row of a table as a card: here are its labels.
const SHORT = 12;  // characters; such entries share a line
addEventListener("DOMContentLoaded", () => {
  for (const table of document.querySelectorAll("main table")) {
    const head = [...table.tHead?.rows ?? []].map(row => [...row.cells].map(cell => cell.textContent.trim()));
    const index = head.length === 2 && !head[1].slice(1).join("") ? head.pop().slice(0, 1) : [];  // pandas names it below
    if (head.length !== 1 || table.querySelector("tbody [rowspan], [colspan]")) continue;  // which scrolls
    const names = index.concat(head[0].slice(index.length));
    table.classList.add("cards");
    for (const row of table.querySelectorAll("tbody tr"))
      [...row.cells].forEach((cell, k) => {
        if (names[k]) cell.dataset.label = names[k];
        cell.classList.toggle("short", cell.textContent.trim().length <= SHORT);
      });
  }
  // What a program prints in columns keeps its lines, except where a line is a long sentence.
  for (const text of document.querySelectorAll("main .output pre"))
    if (/\S {3,}\S/.test(text.textContent) && !/.{101}/.test(text.textContent)) text.classList.add("aligned");
});
