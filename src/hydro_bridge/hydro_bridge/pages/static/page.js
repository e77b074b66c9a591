// SPDX-License-Identifier: Apache-2.0
// The page: hears the dashboard's frames, shows them, and sends commands with the epoch that was on the screen.

import { Curve, Plots, shown } from "./plots.js";
import { Series, decoded } from "./series.js";

const SILENT = 700; // ms without a word of the dashboard: the connection is lost
const BEHIND = 2000; // ms of lag beyond which the page drops what is under way and connects again, to show now
const REDRAW = 95; // ms between two drawings: a person sees no more, and this machine may control a bench
const AGAIN = 500; // ms until the next attempt to connect
const APART = 400; // ms: a second press that comes sooner is one that bounced, or a key that is held
const SURE = 5000; // ms in which a second press means yes
const TROUBLE = ["watchdog", "tripped", "sensor fault", "force limit", "filter stale"];
const LEVELS = ["ok", "warn", "error", "silent"];

const $ = (id) => document.getElementById(id);
const plots = new Plots($("plots"));
const curve = new Curve($("curve"));
let series = null;
let binWidth = 0.01;
let pulse = null;
let heard = 0;
let least = Infinity; // ms between the clocks of page and dashboard; what is more is lag
let lag = 0;
let drawn = 0;
let changed = false;
let held = false;
let socket = null;

function connect() {
  const opened = new WebSocket(`ws://${location.host}/socket`);
  socket = opened;
  lag = 0;
  opened.binaryType = "arraybuffer";
  opened.onmessage = (event) => {
    if (opened !== socket) return; // dropped: see BEHIND
    heard = performance.now();
    if (event.data instanceof ArrayBuffer) take(decoded(event.data));
    else {
      const told = JSON.parse(event.data);
      TOLD[told.kind]?.(told);
    }
  };
  opened.onclose = () => {
    if (opened !== socket) return;
    least = Infinity; // another dashboard may answer, with another clock
    setTimeout(connect, AGAIN);
  };
}

function skip() {
  const behind = socket;
  connect();
  behind.close();
}

function take(frame) {
  if (!series) return;
  series[frame.series].add(frame.first, frame.values);
  changed = true;
}

const TOLD = {
  hello(told) {
    binWidth = told.bin_width;
    series = told.series.map((columns) => new Series(columns));
  },
  pulse(told) {
    if (pulse && pulse.epoch !== told.epoch) calm();
    pulse = told;
    const apart = performance.now() - told.sent;
    least = Math.min(least, apart);
    lag = apart - least;
    standing();
    if (lag > BEHIND) skip();
  },
  words,
  answer(told) {
    answered(`${told.command}: ${told.text}`, told.success);
  },
};

// What the plant is, in the largest letters; what is old is grey, and says so.
function standing() {
  const quiet = performance.now() - heard;
  let banner = "";
  if (!pulse || quiet > SILENT) banner = `No connection to the dashboard${pulse ? ` for ${(quiet / 1000).toFixed(1)} s` : ""}: nothing here is live.`;
  else if (lag > SILENT) banner = `The connection is slow: what is shown is ${(lag / 1000).toFixed(1)} s old.`;
  else if (pulse.contested) banner = "Two nodes publish the plant's state: what is shown is not believed.";
  else if (pulse.age === null) banner = "No plant: no sample has come yet.";
  else if (!pulse.alive) banner = `The plant is silent: no sample for ${pulse.age.toFixed(1)} s. What is shown is old.`;
  document.body.classList.toggle("stale", Boolean(banner));
  if ($("banner").textContent !== banner) $("banner").textContent = banner;
  const flags = banner || !pulse ? [] : pulse.flags;
  const state = banner ? "unknown" : flags.includes("tripped") ? "tripped" : flags.includes("armed") ? "armed" : "disarmed";
  $("state").className = `state ${state}`;
  $("state").textContent = { unknown: "NOT LIVE", tripped: "TRIPPED", armed: "ARMED", disarmed: "disarmed" }[state];
  document.title = `${$("state").textContent} - hydro`;
  if (!pulse) return;
  $("holder").textContent = pulse.holder || "nobody";
  const chips = flags.filter((flag) => flag !== "armed").map((flag) => `<span class="${TROUBLE.includes(flag) ? "trouble" : ""}">${flag}</span>`).join("");
  if ($("flags").innerHTML !== chips) $("flags").innerHTML = chips;
}

function draw() {
  requestAnimationFrame(draw);
  const now = performance.now();
  if (!series || !changed || held || now - drawn < REDRAW) return;
  changed = false;
  drawn = now;
  plots.draw(series, binWidth);
}

function list(id, rows) {
  $(id).replaceChildren(...rows.flatMap(([name, value, trouble]) => {
    const [term, said] = [document.createElement("dt"), document.createElement("dd")];
    [term.textContent, said.textContent] = [name, value];
    if (trouble) said.className = "trouble";
    return [term, said];
  }));
}

function words(told) {
  const { box, training, nodes } = told;
  const node = (name) => nodes.find((one) => one.name === name)?.values ?? {};
  const plant = { ...node("sim"), ...node("bridge") };
  const trainer = { ...node("evaluate"), ...node("trainer") };
  const filter = nodes.find((one) => one.name === "filter");
  $("plant").textContent = box.plant ? `${box.plant}, ${box.firmware || "box"}, bench ${box.bench.slice(0, 8) || "not known"}` : "no box has said what it is";
  list("training", training.phase ? [
    ["phase", training.phase, training.phase === "paused"],
    ["episode, step", `${training.episode}, ${training.step}`],
    ["last return", shown(training.episode_return ?? NaN)],
    ["last RMSE", `${shown(training.force_rmse ?? NaN)} N`],
    ["entropy coefficient", shown(training.entropy_coefficient ?? NaN)],
    ["updates", training.updates],
    ["learner", training.learner_alive ? "alive" : "DOWN", !training.learner_alive],
    ["recording", trainer.recording ?? "-", trainer.recording?.startsWith("LOST")],
    ["examination", trainer.examination ?? "-"],
    ["rollbacks", trainer.rollbacks ?? "-"],
    ["gains by hand", trainer.override ?? "-", trainer.override && trainer.override !== "no"],
  ] : [["", "no trainer runs"]]);
  curve.draw(told.curve);
  const estimator = nodes.find((one) => one.name === "compensation" && one.age <= 3);
  const health = estimator?.values ?? {};
  list("law", [
    ["acts", told.law],
    ["estimator", estimator ? estimator.message : "none runs", health.frozen && health.frozen !== "no"],
    ["excitation", health.excitation ? shown(Number(health.excitation)) : "-"],
    ["at a bound", health["at a bound"] ?? "-", health["at a bound"] === "yes"],
    ["policy steps held", health["policy steps held"] ?? "-"],
  ]);
  const decided = Object.entries(told.filter).map(([status, count]) => [status, `${count} in the last ½ s`, !["pass", "modified"].includes(status)]);
  list("filter", [
    ["status", filter ? filter.message : "no filter runs", !filter || filter.level > 0],
    ["model fits this bench", filter?.values.fits ?? "-", (filter?.values.fits ?? "yes") !== "yes"],
    ...decided,
  ]);
  list("line", [
    ["state in to correction out", latency(plant["state in to correction out"])],
    ["command to confirmation", latency(plant["command out to confirmation in"])],
    ["lost on the line", plant.lost ?? "-", Number(plant.lost) > 0],
    ["missed by this page", told.missed],
    ["viewers", told.viewers],
  ]);
  list("publishers", Object.entries(told.publishers).map(([topic, names]) => [topic.split("/").at(-1), names.join(", ") || "nobody", names.length > 1]));
  tell(nodes);
}

// "p50 0.66 p99 1.70 p99.9 2.54 max 9.03 ms" in two figures.
function latency(sentence) {
  const found = /p50 (\S+)\s+p99 (\S+).* (\S+)$/.exec(sentence ?? "");
  return found ? `${Number(found[1]).toFixed(1)}, p99 ${Number(found[2]).toFixed(1)} ${found[3]}` : sentence ?? "-";
}

function tell(nodes) {
  const open = new Set([...$("nodes").querySelectorAll("details[open]")].map((one) => one.dataset.name));
  $("nodes").replaceChildren(...nodes.map((one) => {
    const details = document.createElement("details");
    details.dataset.name = one.name;
    details.open = open.has(one.name);
    const level = one.age > 3 ? "silent" : LEVELS[one.level] ?? "silent";
    const summary = document.createElement("summary");
    const [said, name] = [document.createElement("span"), document.createElement("b")];
    [said.className, said.textContent, name.textContent] = [`level ${level}`, level === "silent" ? `silent for ${one.age.toFixed(0)} s` : level, one.name];
    summary.append(said, name, one.message);
    const figures = document.createElement("dl");
    figures.id = `figures-${one.name}`;
    details.append(summary, figures);
    queueMicrotask(() => details.open && list(figures.id, Object.entries(one.values)));
    details.addEventListener("toggle", () => details.open && list(figures.id, Object.entries(one.values)));
    return details;
  }));
}

// Commands. What needs care is pressed twice; the epoch is the one of the first press.
function send(command, more = {}, epoch = pulse?.epoch ?? "") {
  if (socket?.readyState !== WebSocket.OPEN) {
    answered(`${command}: not sent, there is no connection to the dashboard`, false);
    return;
  }
  socket.send(JSON.stringify({ command, epoch, token: $("token").value, ...more }));
  answered(`${command}: asked …`, true);
}

function answered(text, success) {
  $("answer").textContent = text;
  $("answer").className = success ? "" : "refused";
}

function calm() {
  for (const button of document.querySelectorAll("button.sure")) button.calm();
}

function pressedTwice(button, words_, command) {
  const first = button.textContent;
  let epoch = "";
  let waiting = 0;
  let pressed = 0;
  button.calm = () => {
    clearTimeout(waiting);
    button.classList.remove("sure");
    button.textContent = first;
  };
  button.onclick = () => {
    if (button.classList.contains("sure")) {
      if (performance.now() - pressed < APART) return;
      button.calm();
      send(command, {}, epoch);
      return;
    }
    epoch = pulse?.epoch ?? "";
    pressed = performance.now();
    button.classList.add("sure");
    button.textContent = words_;
    waiting = setTimeout(button.calm, SURE);
  };
}

$("disarm").onclick = () => send("disarm");
addEventListener("keydown", (event) => {
  if (event.key !== "Escape") return;
  event.preventDefault();
  if (!event.repeat) send("disarm");
}, true);
pressedTwice($("arm"), "arm it now", "arm");
pressedTwice($("end"), "end it now", "end");
for (const command of ["release", "freeze", "adapt"]) $(command).onclick = () => send(command);
const entered = (id) => (Number.isFinite($(id).valueAsNumber) ? $(id).valueAsNumber : undefined);
$("override").onclick = () => send("override", { kp: entered("kp"), ki: entered("ki"), seconds: entered("seconds") });
$("commands").onsubmit = (event) => event.preventDefault();
$("hold").onclick = () => {
  held = !held;
  $("hold").classList.toggle("chosen", held);
};
for (const button of document.querySelectorAll("[data-seconds]")) {
  button.onclick = () => {
    plots.seconds = Number(button.dataset.seconds);
    document.querySelectorAll("[data-seconds]").forEach((one) => one.classList.toggle("chosen", one === button));
    changed = true;
  };
}

// The token comes behind # and leaves the address bar: it is in no request, no history, no picture of the screen.
// The tab keeps it for when it is loaded again.
const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given) {
  sessionStorage.setItem("token", given);
  history.replaceState(null, "", location.pathname);
}
$("token").value = sessionStorage.getItem("token") ?? "";
setInterval(standing, 200);
connect();
draw();
