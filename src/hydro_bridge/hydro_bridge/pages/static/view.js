// SPDX-License-Identifier: Apache-2.0
// A recording: the plots of the live page over a window that a slider moves, and what happened as a list to press on.

import { colour, Curve, Plots, shaded, shown } from "./plots.js";
import { Series } from "./series.js";

// Colours of Okabe and Ito; the list says in words what each is.
const COLOURS = {
  armed: colour("blue"), trip: colour("vermilion"), watchdog: "#e69f00", authority: colour("ink"), episode: "#b8c0c6", phase: "#5c6670",
  examination: colour("green"), rollback: "#cc79a7", override: "#56b4e9", learner: colour("brown"), weights: "#6a3d9a",
  call: "#7b3294", log: "#b35806", window: "#35978f",
};
const QUIET = ["episode", "phase", "log", "weights"]; // kinds that are not chosen at first if they are many
const MANY = 40;
const LISTED = 400; // lines: the nearest ones
const STEP = 0.1; // of the window, for an arrow key

const $ = (id) => document.getElementById(id);
const about = JSON.parse($("about").textContent);
const plots = new Plots($("plots"));
const chosen = new Set();
let series = [];
let windowed = 10; // s; Infinity: all
let at = 0; // s: where a person looks
let playing = 0;
let asked = false;

async function unpacked(script) {
  const bytes = Uint8Array.from(atob(script.textContent), (character) => character.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Float32Array(await new Response(stream).arrayBuffer());
}

function clock(seconds) {
  const whole = Math.floor(seconds / 60);
  return whole ? `${whole} min ${(seconds % 60).toFixed(1)} s` : `${seconds.toFixed(2)} s`;
}

function go(time) {
  at = Math.min(Math.max(time, 0), about.seconds);
  $("time").value = at;
  if (asked) return;
  asked = true;
  requestAnimationFrame(draw);
}

function draw() {
  asked = false;
  plots.seconds = Math.min(windowed, about.seconds);
  const right = Math.min(Math.max(at + plots.seconds / 2, plots.seconds), about.seconds);
  const bin = Math.min(Math.floor(at / about.bin_width), series[0].end - 1);
  plots.marks = [...about.marks.filter((one) => chosen.has(one.kind)).map((one) => [one.time, COLOURS[one.kind]]), [at, colour("soft")]];
  plots.draw(series, about.bin_width, Math.ceil(right / about.bin_width), 0, bin);
  const [armed, tripped] = ["armed", "tripped"].map((name) => series[0].at(name, bin));
  const state = Number.isNaN(armed) ? "unknown" : tripped ? "tripped" : armed ? "armed" : "disarmed";
  $("state").className = `state ${state}`;
  $("state").textContent = { unknown: "no sample", tripped: "TRIPPED", armed: "ARMED", disarmed: "disarmed" }[state];
  $("at").textContent = `${clock(at)} of ${clock(about.seconds)}`;
  $("holder").textContent = about.marks.findLast((one) => one.kind === "authority" && one.time <= at)?.text ?? "";
  strip();
  list();
}

// The whole recording in a strip: grey where disarmed, hatched where tripped, lines where something happened.
function strip() {
  const canvas = $("strip");
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  [canvas.width, canvas.height] = [width, height];
  const ctx = canvas.getContext("2d");
  const x = (time) => (time / about.seconds) * width;
  ctx.fillStyle = colour("paper");
  ctx.fillRect(0, 0, width, height);
  for (const [from, to, tripped] of strip.bands) {
    ctx.fillStyle = colour(tripped ? "tripped" : "disarmed");
    ctx.fillRect(x(from), 0, Math.max(1, x(to) - x(from)), height);
  }
  for (const one of about.marks) {
    if (!chosen.has(one.kind)) continue;
    ctx.fillStyle = COLOURS[one.kind];
    ctx.fillRect(x(one.time) - 0.75, 0, 1.5, height);
  }
  ctx.fillStyle = colour("ink");
  ctx.fillRect(x(at) - 1.5, 0, 3, height);
}

function list() {
  const marks = about.marks.filter((one) => chosen.has(one.kind));
  const next = marks.findIndex((one) => one.time > at + 1e-6);
  const now = (next < 0 ? marks.length : next) - 1;
  const first = Math.max(0, Math.min(now - LISTED / 2, marks.length - LISTED));
  $("marks").replaceChildren(...marks.slice(first, first + LISTED).map((one, n) => {
    const line = document.createElement("button");
    const [dot, time] = [document.createElement("i"), document.createElement("b")];
    dot.style.background = COLOURS[one.kind];
    time.textContent = clock(one.time);
    line.type = "button";
    line.className = first + n === now ? "now" : "";
    line.append(dot, time, one.text);
    line.onclick = () => go(one.time);
    return line;
  }));
  if (list.now !== now) {
    list.now = now;
    const line = $("marks").querySelector(".now");
    if (line) $("marks").scrollTop = line.offsetTop - $("marks").offsetTop - $("marks").clientHeight / 2;
  }
}

function kinds() {
  const counts = new Map();
  for (const one of about.marks) counts.set(one.kind, (counts.get(one.kind) ?? 0) + 1);
  $("kinds").append(...[...counts].map(([kind, count]) => {
    const label = document.createElement("label");
    const [box, dot] = [document.createElement("input"), document.createElement("i")];
    box.type = "checkbox";
    box.checked = !QUIET.includes(kind) || count <= MANY;
    box.onchange = () => {
      chosen[box.checked ? "add" : "delete"](kind);
      go(at);
    };
    if (box.checked) chosen.add(kind);
    dot.style.background = COLOURS[kind];
    label.append(box, dot, `${kind} (${count})`);
    return label;
  }));
}

function play() {
  playing = playing ? 0 : performance.now();
  $("play").textContent = playing ? "stop" : "play";
  const step = (now) => {
    if (!playing) return;
    const speed = Math.max(1, Math.min(windowed, about.seconds) / 10);
    go(at + 1e-3 * (now - playing) * speed);
    playing = now;
    if (at >= about.seconds) play();
    else requestAnimationFrame(step);
  };
  if (playing) requestAnimationFrame(step);
}

function jump(way) {
  const times = about.marks.filter((one) => chosen.has(one.kind)).map((one) => one.time);
  const to = way > 0 ? times.find((time) => time > at + 1e-6) : times.findLast((time) => time < at - 1e-6);
  if (to !== undefined) go(to);
}

const KEYS = {
  ArrowLeft: () => go(at - STEP * plots.seconds), ArrowRight: () => go(at + STEP * plots.seconds),
  n: () => jump(1), p: () => jump(-1), " ": play, Home: () => go(0), End: () => go(about.seconds),
};
addEventListener("keydown", (event) => {
  if (!KEYS[event.key] || event.ctrlKey || event.altKey || event.metaKey) return;
  if (event.key === " " && event.target.matches("button, input")) return; // space is theirs
  event.preventDefault();
  KEYS[event.key]();
});
for (const button of document.querySelectorAll("[data-seconds]")) {
  button.onclick = () => {
    windowed = Number(button.dataset.seconds);
    document.querySelectorAll("[data-seconds]").forEach((one) => one.classList.toggle("chosen", one === button));
    go(at);
  };
}
$("time").max = about.seconds;
$("time").step = about.bin_width;
$("time").oninput = () => go($("time").valueAsNumber);
$("strip").onclick = (event) => go((event.offsetX / $("strip").clientWidth) * about.seconds);
$("play").onclick = play;
$("next").onclick = () => jump(1);
$("previous").onclick = () => jump(-1);
addEventListener("resize", () => go(at));

const values = await Promise.all([...document.querySelectorAll("script.table")].map(unpacked));
series = about.series.map((columns, n) => {
  const made = new Series(columns, Math.max(1, values[n].length / (2 * columns.length)));
  made.add(0, values[n]);
  return made;
});
const all = series[0].end;
const stride = Math.max(1, Math.ceil(all / 2000));
strip.bands = shaded(series[0], all, Math.floor(all / stride), stride, about.bin_width, all * about.bin_width);
kinds();
$("happened").hidden = !about.marks.length;
$("learner").hidden = !about.curve.episode.length;
new Curve($("curve")).draw(about.curve);
go(0);
document.body.classList.remove("stale");
