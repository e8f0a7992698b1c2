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

// Curves against steps or seconds.
for (const figure of all("figure.switch")) {
  const buttons = all("button", figure), shown = all(".drawn", figure);
  const show = at => buttons.forEach((button, i) => {
    button.setAttribute("aria-pressed", i === at);
    shown[i].hidden = i !== at;
  });
  buttons.forEach((button, i) => button.addEventListener("click", () => show(i)));
  show(0);
}

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

// Points against their values on axes: dots of two columns, or a line over all axes.
for (const svg of all("svg.values")) {
  const [mode, across, up, tint] = ["as", "x", "y", "colour"].map(part => document.querySelector(`#values [data-part="${part}"]`));
  const metrics = all("#points thead th[data-group]").map(head => head.textContent.trim());
  const points = all("#points tbody tr[data-axes]").map(row => {
    const numbers = all("td[data-group]", row).map(cell => cell.dataset.value === "" ? null : Number(cell.dataset.value));
    const name = [row.cells[1], row.cells[2]].map(cell => cell.textContent).join(", ") + `, seed ${row.cells[3].textContent}`;
    return { name, values: { ...JSON.parse(row.dataset.axes), row: row.dataset.row, ...Object.fromEntries(metrics.map((metric, i) => [metric, numbers[i]])) } };
  });
  const axes = [...new Set(points.flatMap(point => Object.keys(point.values)))].filter(name => name !== "row" && !metrics.includes(name));
  const rows = new Set(points.map(point => point.values.row)).size > 1 ? ["row"] : [];
  const fill = (select, names) => select.append(...names.map(name => new Option(name, name)));
  fill(across, [...axes, ...metrics]);
  fill(up, [...metrics, ...axes]);
  fill(tint, ["nothing", ...rows, ...axes, ...metrics]);
  tint.value = [...rows, ...axes.slice(1), metrics[0]][0];
  const make = (name, attributes, text) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    svg.append(made);
    return made;
  };
  const short = value => typeof value === "number" ? String(Number(value.toPrecision(3))) : value;
  // Where values stand between 0 and 1, and the values that are written beside the scale.
  const scale = name => {
    const found = [...new Set(points.map(point => point.values[name]).filter(value => value !== null && value !== undefined))];
    if (found.some(value => typeof value !== "number")) {
      return { at: value => found.length > 1 ? found.indexOf(value) / (found.length - 1) : 0.5, ticks: found };
    }
    const [least, most] = [Math.min(...found), Math.max(...found)], log = least > 0 && most / least >= 30;
    const [from, to] = [least, most].map(value => log ? Math.log10(value) : value);
    const at = value => to > from ? ((log ? Math.log10(value) : value) - from) / (to - from) : 0.5;
    const few = found.length <= 6 ? found : Array.from({ length: 5 }, (_, i) => from + (to - from) * i / 4).map(value => log ? 10 ** value : value);
    return { at, ticks: few };
  };
  const colour = share => `hsl(${Math.round(270 - 220 * share)} 65% ${Math.round(38 + 17 * share)}%)`;
  const colours = () => {
    const tints = tint.value === "nothing" ? null : scale(tint.value);
    return point => tints && known(point, [tint.value]) ? colour(tints.at(point.values[tint.value])) : "#888";
  };
  const [left, right, top, bottom] = [80, 880, 30, 360];
  const known = (point, names) => names.every(name => point.values[name] !== null && point.values[name] !== undefined);
  const dots = () => {
    const [x, y, ofPoint] = [scale(across.value), scale(up.value), colours()];
    const [px, py] = [share => left + (right - left) * share, share => bottom - (bottom - top) * share];
    for (const value of x.ticks) {
      make("line", { class: "grid", x1: px(x.at(value)), x2: px(x.at(value)), y1: top, y2: bottom });
      make("text", { x: px(x.at(value)), y: bottom + 18, "text-anchor": "middle" }, short(value));
    }
    for (const value of y.ticks) {
      make("line", { class: "grid", x1: left, x2: right, y1: py(y.at(value)), y2: py(y.at(value)) });
      make("text", { x: left - 8, y: py(y.at(value)) + 4, "text-anchor": "end" }, short(value));
    }
    make("text", { x: (left + right) / 2, y: bottom + 40, "text-anchor": "middle" }, across.value);
    make("text", { x: left, y: top - 12 }, up.value);
    for (const point of points.filter(point => known(point, [across.value, up.value]))) {
      const mark = make("circle", { class: "mark", r: 5, cx: px(x.at(point.values[across.value])), cy: py(y.at(point.values[up.value])), fill: ofPoint(point) });
      mark.append(title(point));
    }
  };
  const lines = () => {
    const shared = axes.filter(name => name !== up.value && points.every(point => known(point, [name])));
    const names = [...shared, up.value], scales = names.map(scale), ofPoint = colours();
    if (!shared.length) make("text", { x: left, y: top - 12 }, "Each point has values on some axes only: there are no lines over all.");
    const px = i => left + (right - left) * (names.length > 1 ? i / (names.length - 1) : 0.5), py = share => bottom - (bottom - top) * share;
    for (const point of points.filter(point => known(point, names))) {
      const path = names.map((name, i) => `${px(i)},${py(scales[i].at(point.values[name]))}`).join(" ");
      make("polyline", { class: "line", points: path, stroke: ofPoint(point) }).append(title(point));
    }
    names.forEach((name, i) => {
      make("line", { class: "grid", x1: px(i), x2: px(i), y1: top, y2: bottom });
      make("text", { x: px(i), y: bottom + 22, "text-anchor": "middle" }, name);
      for (const value of scales[i].ticks) make("text", { x: px(i) - 6, y: py(scales[i].at(value)) + 4, "text-anchor": "end" }, short(value));
    });
  };
  const title = point => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", "title");
    made.textContent = point.name + Object.entries(point.values).map(([name, value]) => `\n${name}: ${short(value)}`).join("");
    return made;
  };
  const draw = () => {
    svg.replaceChildren();
    all("#values [data-only]").forEach(part => part.hidden = part.dataset.only !== mode.value);
    mode.value === "scatter" ? dots() : lines();
    if (tint.value === "nothing") return;
    const { at, ticks } = scale(tint.value);
    make("text", { x: left, y: 412 }, tint.value);
    if (ticks.length > 8) return;
    [...ticks].sort((a, b) => at(a) - at(b)).forEach((value, i) => {
      const x = left + 20 + 8 * tint.value.length + 80 * i;
      make("circle", { r: 5, cx: x, cy: 408, fill: colour(at(value)) });
      make("text", { x: x + 10, y: 412 }, short(value));
    });
  };
  for (const control of [mode, across, up, tint]) control.addEventListener("input", draw);
  draw();
}
