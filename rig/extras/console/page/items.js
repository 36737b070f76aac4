// Elements of a result as the server sends them (rig.core.present): headings, rows, tables and checks.

import { make } from "./dom.js";

export function shown(items) {
  const parts = [];
  let rows = null;
  for (const item of items) {
    if ("row" in item) {
      if (rows === null) parts.push(make("table", {}, (rows = make("tbody"))));
      rows.append(make("tr", {}, make("th", { scope: "row", textContent: item.row }), make("td", { textContent: item.text })));
      continue;
    }
    rows = null;
    if ("heading" in item) parts.push(make("h3", { textContent: item.heading }));
    else if ("table" in item) parts.push(table(item));
    else parts.push(check(item));
  }
  return parts;
}

function table({ table: caption, head, rows, words }) {
  const cell = (tag, text, place) => make(tag, { textContent: text, className: place < words ? "" : "number" });
  return make("table", {}, make("caption", { textContent: caption }),
    make("thead", {}, make("tr", {}, ...head.map((text, i) => cell("th", text, i)))),
    make("tbody", {}, ...rows.map((row) => make("tr", {}, ...row.map((text, i) => cell("td", text, i))))));
}

function check({ check: name, outcome, text, remedy }) {
  return make("p", { className: "finding", dataset: { outcome } }, make("strong", { textContent: `${outcome}: ${name}` }), ` ${text}`,
    remedy ? make("span", { className: "remedy", textContent: ` ${remedy}` }) : null);
}
