"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const FIRST = 200;  // rows before "Show all": a page that opens at once
  const STATE = 0, FOLDER = 1, NAME = 2, VEHICLE = 3, BEGAN = 4, LENGTH = 5, FINDINGS = 6,
    WORDS = 7, LOST = 8, REPORT = 9;
  const body = document.getElementById("rows");
  const find = document.getElementById("find");
  const state = document.getElementById("state");
  const vehicle = document.getElementById("vehicle");
  const more = document.getElementById("more");
  const shown = document.getElementById("shown");
  const heads = [...document.querySelectorAll("#table thead th")];
  const badges = data.states.map(([, mark]) => document.getElementById("badge-" + mark).content);
  const order = new Intl.Collator("en", { numeric: true });
  const haystack = data.rows.map((row) =>
    [row[NAME], data.folders[row[FOLDER]], data.vehicles[row[VEHICLE]], row[WORDS],
      row[LOST] && "lost " + row[LOST], row[BEGAN]].join("\n").toLowerCase());
  let column = null, backwards = false, all = false;

  for (const name of data.vehicles) vehicle.add(new Option(name, name));

  const length = (seconds) => {
    if (seconds === null) return "";
    if (seconds < 120) return seconds.toFixed(seconds < 10 ? 1 : 0) + " s";
    const minutes = Math.round(seconds / 60);
    return minutes < 120 ? minutes + " min" : (seconds / 3600).toFixed(1) + " h";
  };

  const cell = (text, kind) => {
    const made = document.createElement("td");
    made.textContent = text;
    if (kind) made.className = kind;
    return made;
  };

  const line = (row) => {
    const made = document.createElement("tr");
    const verdict = document.createElement("td");
    verdict.append(badges[row[STATE]].cloneNode(true));
    const name = document.createElement("td");
    const text = row[REPORT] ? document.createElement("a") : document.createElement("span");
    if (row[REPORT]) text.href = row[REPORT];
    text.textContent = row[NAME];
    name.append(text);
    if (data.folders[row[FOLDER]]) {
      const folder = document.createElement("small");
      folder.textContent = data.folders[row[FOLDER]];
      name.append(folder);
    }
    made.append(verdict, name, cell(data.vehicles[row[VEHICLE]]), cell(row[BEGAN]),
      cell(length(row[LENGTH]), "number"), cell(row[FINDINGS] || "", "number"), cell(row[WORDS]),
      cell(row[LOST]));
    return made;
  };

  const compare = (a, b) => {
    let one = data.rows[a][column], two = data.rows[b][column];
    if (one === two) return a - b;
    if (one === null || one === "") return 1;  // what is not known is last, either way
    if (two === null || two === "") return -1;
    const answer = typeof one === "string" ? order.compare(one, two) : one - two;
    return (backwards ? -answer : answer) || a - b;
  };

  const draw = () => {
    const words = find.value.toLowerCase().split(/\s+/).filter(Boolean);
    const wanted = data.states.findIndex(([name]) => name === state.value);
    const owner = data.vehicles.indexOf(vehicle.value);
    let found = [];
    for (let k = 0; k < data.rows.length; k += 1) {
      const row = data.rows[k];
      if (wanted >= 0 && row[STATE] !== wanted) continue;
      if (owner >= 0 && row[VEHICLE] !== owner) continue;
      if (words.every((word) => haystack[k].includes(word))) found.push(k);
    }
    if (column !== null) found.sort(compare);
    const count = found.length;
    if (!all) found = found.slice(0, FIRST);
    body.replaceChildren(...found.map((k) => line(data.rows[k])));
    shown.textContent = count === data.rows.length ? count + " logs" : count + " of " + data.rows.length + " logs";
    more.hidden = found.length === count;
    more.textContent = "Show all " + count;
    for (const head of heads) {
      const own = Number(head.firstElementChild.dataset.column) === column;
      if (own) head.setAttribute("aria-sort", backwards ? "descending" : "ascending");
      else head.removeAttribute("aria-sort");
    }
    for (const button of document.querySelectorAll(".counts button"))
      button.setAttribute("aria-pressed", String(button.dataset.state === state.value));
  };

  for (const head of heads) head.firstElementChild.addEventListener("click", () => {
    const chosen = Number(head.firstElementChild.dataset.column);
    // Numbers and dates are looked at from the largest down.
    backwards = chosen === column ? !backwards : chosen >= BEGAN && chosen <= FINDINGS;
    column = chosen;
    draw();
  });
  for (const button of document.querySelectorAll(".counts button"))
    button.addEventListener("click", () => {
      state.value = state.value === button.dataset.state ? "" : button.dataset.state;
      draw();
    });
  for (const link of document.querySelectorAll("a[href='#logs']"))
    link.addEventListener("click", () => {
      find.value = link.dataset.find || "";
      state.value = link.dataset.state || "";
      vehicle.value = link.dataset.vehicle || "";
      draw();
    });
  find.addEventListener("input", draw);
  state.addEventListener("change", draw);
  vehicle.addEventListener("change", draw);
  more.addEventListener("click", () => { all = true; draw(); });
  draw();
})();
