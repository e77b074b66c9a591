// SPDX-License-Identifier: Apache-2.0
// Recordings dropped on the page go to the server as they are; what it finds in them comes back, and in the end a report.

const PIECE = 1 << 20; // bytes of a file in one message
const COLUMNS = ["column", "unit", "count", "rate", "low", "high", "shape"];
const GIVEN = [["unit", "in"], ["scale", "factor"], ["offset", "offset"]]; // of a map's entry, and their titles
const $ = (id) => document.getElementById(id);
const socket = new WebSocket(`ws://${location.host}/socket`);
const recordings = new Map(); // name: "fit" or "check"
const arriving = new Set(); // names of files of which the server has not answered
let queue = Promise.resolve(); // one message or file after the other
let rows = [];

function cell(row, content, name = "td") {
  const made = row.appendChild(document.createElement(name));
  made.append(content);
  return made;
}

function send(kind, content) {
  $("error").textContent = "";
  queue = queue.then(() => socket.send(JSON.stringify({ type: kind, ...content })));
}

function upload(files) {
  const bench = ({ name }) => /\.ya?ml$/.test(name); // first: it tells what numbers are likely
  for (const file of [...files].sort((one, other) => bench(other) - bench(one))) {
    send("upload", { name: file.name, size: file.size });
    for (let at = 0; at < file.size; at += PIECE) {
      queue = queue.then(async () => socket.send(await file.slice(at, at + PIECE).arrayBuffer()));
    }
    arriving.add(file.name);
  }
  arrived();
}

function arrived(name) {
  arriving.delete(name);
  $("run").disabled = arriving.size > 0 || !$("bar").hidden;
  $("loading").textContent = arriving.size ? `reading ${[...arriving].join(", ")}` : "";
}

function list() {
  $("recordings").hidden = !recordings.size;
  $("list").replaceChildren(...[...recordings].map(([name, use]) => {
    const row = document.createElement("tr");
    const choice = document.createElement("select");
    for (const [value, text] of [["fit", "fit"], ["check", "hold out"], ["", "leave out"]]) {
      choice.add(new Option(text, value, false, value === use));
    }
    choice.onchange = () => recordings.set(name, choice.value);
    cell(row, name);
    cell(row, choice);
    return row;
  }));
}

function columns() {
  const chosen = {};
  for (const row of $("columns").querySelectorAll("tr[data-column]")) {
    const field = row.querySelector("select").value;
    if (!field) continue;
    chosen[field] = { column: row.dataset.column };
    for (const { name, value } of row.querySelectorAll("input")) if (value.trim()) chosen[field][name] = value.trim();
  }
  return chosen;
}

function table(proposed) {
  const head = document.createElement("tr");
  for (const name of [...COLUMNS, "signal", ...GIVEN.map(([, title]) => title)]) cell(head, name, "th");
  const becomes = Object.fromEntries(Object.entries(proposed).map(([field, source]) => [source.column, [field, source]]));
  $("columns").replaceChildren(head, ...rows.map((entry) => {
    const row = document.createElement("tr");
    const [field, source] = becomes[entry.column] ?? ["", {}];
    row.dataset.column = entry.column;
    for (const key of COLUMNS) cell(row, entry[key]).className = key === "shape" ? "curve" : "";
    const choice = $("fields").content.firstElementChild.cloneNode(true);
    choice.value = field;
    cell(row, choice);
    for (const [name] of GIVEN) {
      const given = document.createElement("input");
      [given.name, given.value] = [name, source[name] ?? ""];
      if (name === "unit") given.setAttribute("list", "units");
      cell(row, given);
    }
    row.onchange = () => send("check", { columns: columns() });
    return row;
  }));
  $("mapping").hidden = false;
}

function tell({ doubts, missing }) {
  $("remarks").replaceChildren(...[...doubts, ...missing].map((sentence) => {
    const line = document.createElement("li");
    line.textContent = sentence;
    line.className = doubts.includes(sentence) ? "" : "quiet";
    return line;
  }));
}

function save(id, text, kind) {
  const address = URL.createObjectURL(new Blob([text], { type: kind }));
  $(id).href = address;
  return address;
}

function running(now) {
  $("bar").hidden = !now;
  arrived();
}

const ANSWERS = {
  columns({ name, rows: found, proposed, ...remarks }) {
    arrived(name);
    recordings.set(name, recordings.get(name) ?? "fit");
    list();
    if (rows.length) return; // the map of the first recording holds for all
    rows = found;
    table(proposed);
    tell(remarks);
  },
  bench({ name }) {
    arrived(name);
    $("bench").textContent = name;
  },
  checked: tell,
  progress({ text, done, stages }) {
    $("stage").textContent = text;
    $("bar").max = stages;
    $("bar").value = Math.max($("bar").value, done ?? 0); // a stage may be repeated
  },
  report({ verdict, report, corrected, columns: map }) {
    running(false);
    $("bar").value = $("bar").max;
    $("stage").textContent = verdict.replaceAll("_", " ");
    $("report").src = save("save-report", report, "text/html");
    save("save-corrected", corrected, "text/yaml");
    save("save-columns", map, "text/yaml");
    $("result").hidden = false;
  },
  error({ sentence, name }) {
    if (name) arrived(name);
    else running(false);
    $("error").textContent = sentence;
  },
};

socket.onmessage = ({ data }) => {
  const answer = JSON.parse(data);
  ANSWERS[answer.kind](answer);
};
socket.onclose = () => {
  arriving.clear();
  running(false);
  $("error").textContent = "the program behind this page has ended: start `diagnose --page` again, and reload";
};
$("files").onchange = () => upload($("files").files);
for (const kind of ["dragover", "dragleave", "drop"]) {
  addEventListener(kind, (event) => {
    event.preventDefault();
    $("drop").classList.toggle("over", kind === "dragover");
    if (kind === "drop") upload(event.dataTransfer.files);
  });
}
$("run").onclick = () => {
  const used = (use) => [...recordings].filter(([, chosen]) => chosen === use).map(([name]) => name);
  $("result").hidden = true;
  $("bar").value = 0;
  running(true);
  send("diagnose", { columns: columns(), fit: used("fit"), check: used("check") });
};
