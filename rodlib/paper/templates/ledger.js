// Show the rows that hold every word searched for and have a verdict that is ticked.
"use strict";
const form = document.getElementById("filter");
const rows = [...document.querySelectorAll("#ledger tbody tr")];
const texts = rows.map((row) => row.textContent.toLowerCase());

function filter() {
  const words = document.getElementById("wanted").value.toLowerCase().split(/\s+/);
  const verdicts = new Set(new FormData(form).getAll("verdict"));
  let shown = 0;
  rows.forEach((row, k) => {
    row.hidden = !(verdicts.has(row.dataset.verdict) && words.every((word) => texts[k].includes(word)));
    shown += !row.hidden;
  });
  document.getElementById("shown").textContent = `${shown} of ${rows.length} rows`;
}

form.addEventListener("input", filter);
form.addEventListener("submit", (event) => event.preventDefault());
filter();
