"use strict";
const all = (selector, within = document) => [...within.querySelectorAll(selector)];

// A click on a head sorts by its column: best or least first, then the other way round, then as the definition has it.
for (const table of all("table.sortable")) {
  const body = table.tBodies[0], order = [...body.rows];
  const key = (row, at) => row.cells[at].dataset.value ?? row.cells[at].textContent.trim();
  const compare = (a, b) => isNaN(a) || isNaN(b) ? a.localeCompare(b) : a - b;
  for (const button of all("thead button", table)) button.addEventListener("click", () => {
    const head = button.closest("th"), at = head.cellIndex, down = head.dataset.first === "down";
    const turns = down ? ["descending", "ascending"] : ["ascending", "descending"];
    const turn = turns[turns.indexOf(head.getAttribute("aria-sort")) + 1];
    all("[aria-sort]", table).forEach(other => other.removeAttribute("aria-sort"));
    if (turn) head.setAttribute("aria-sort", turn);
    const [full, empty] = [true, false].map(is => order.filter(row => (key(row, at) !== "") === is));
    const sorted = full.sort((a, b) => compare(key(a, at), key(b, at)) * (turn === "descending" ? -1 : 1));
    body.append(...(turn ? [...sorted, ...empty] : order));
  });
}

// Rows of the tables of results, and columns of all tables, are shown or not.
document.getElementById("filter").addEventListener("input", event => {
  const part = event.target.value.toLowerCase();
  for (const row of all(".results tbody tr")) row.hidden = !row.cells[0].textContent.toLowerCase().includes(part);
});
for (const box of all("input[data-group]")) box.addEventListener("change", () => {
  for (const cell of all(`th[data-group="${box.dataset.group}"], td[data-group="${box.dataset.group}"]`)) cell.hidden = !box.checked;
});

// Copies: LaTeX whole, CSV as the tables stand here.
// Text that a spreadsheet would take for a formula gets an apostrophe, as in the files; numbers keep their signs.
const quoted = text => {
  const line = text.replace(/\s+/g, " ").trim();
  const formula = /^[=+\-@]/.test(line) && !/^[+\-][\d.]+(?=$|[\s,%])/.test(line);
  return `"${(formula ? "'" : "") + line.replaceAll('"', '""')}"`;
};
const csv = () => all(".results").map(table => {
  const scene = table.closest("[data-scene]").dataset.scene;
  const line = row => [...row.cells].filter(cell => !cell.hidden).map(cell => quoted(cell.innerText)).join(",");
  return [...table.rows].filter(row => !row.hidden).map((row, i) => (i ? quoted(scene) : '"scene"') + "," + line(row)).join("\n");
}).join("\n");
for (const button of all("[data-copy]")) button.addEventListener("click", () => {
  const area = document.createElement("textarea");
  area.value = button.dataset.copy === "csv" ? csv() : document.getElementById("latex").value;
  document.body.append(area);
  area.select();
  const done = document.execCommand("copy");
  area.remove();
  document.getElementById("copied").textContent = done ? "copied" : "the browser does not let this page copy";
});

// A table or picture that is wider than its box says so.
const hint = box => {
  const wide = box.scrollWidth > box.clientWidth + 1, before = box.previousElementSibling;
  const hints = before?.classList.contains("hint") ? before : box.insertAdjacentElement("beforebegin", document.createElement("p"));
  hints.className = "hint";
  hints.textContent = "scroll sideways for more \u2192";
  hints.hidden = !wide;
};
const hintAll = () => all(".box").forEach(hint);
addEventListener("resize", hintAll);
all("details").forEach(part => part.addEventListener("toggle", hintAll));
hintAll();

// Two pictures of one view, the left one up to the slider.
for (const stage of all(".stage")) {
  const rows = all("tbody tr", document.getElementById(stage.dataset.views)), [left, right, what] = all("select", stage);
  const [under, over] = all("img", stage), slider = stage.querySelector("input");
  for (const select of [left, right]) select.append(...rows.map((row, i) => new Option(row.dataset.name, i)));
  const picture = select => rows[select.value].cells[what.selectedIndex + 1].querySelector("img")?.src;
  const show = () => {
    for (const [image, select] of [[under, right], [over, left]]) {
      const source = picture(select);
      source ? image.src = source : image.removeAttribute("src");
    }
    over.style.clipPath = `inset(0 ${100 - slider.value}% 0 0)`;
  };
  // The first row against the last; a row alone against the ground truth.
  [right.value, left.value] = [rows.length - 1, rows.length > 2 ? 1 : 0];
  for (const control of [left, right, what, slider]) control.addEventListener("input", show);
  show();
  stage.hidden = false;
}
