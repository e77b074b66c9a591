// SPDX-License-Identifier: Apache-2.0
// The plots: one uPlot each, all over the same seconds; where the plant was disarmed or tripped is shaded.

const palette = getComputedStyle(document.documentElement);
export const colour = (name) => palette.getPropertyValue(`--${name}`).trim(); // of palette.css

const [INK, BLUE, VERMILION, GREEN] = ["ink", "blue", "vermilion", "green"].map(colour);
const HEIGHT = 168;
const POINTS = 500; // groups of bins in a plot: of two points each, about as many as it has pixels

// title, [series of states, corrections or laws, name, colour, dash, own axis], least span of the axis
const PLOTS = [
  { title: "Force", unit: "N", span: 40, wide: true, lines: [[0, "force", BLUE], [0, "reference", INK, [6, 4]], [2, "f_c", GREEN, [2, 3]]] },
  { title: "Error", unit: "N", span: 10, lines: [[0, "error", VERMILION]] },
  { title: "Gains", unit: "1/s, 1/s²", span: 10, lines: [[0, "K_p", BLUE], [0, "K_i", VERMILION, [6, 3]]] },
  {
    title: "Coefficients of f_c", unit: "%, ms, 10⁻⁵ s², N, 10⁻⁶ s³", span: 10,
    lines: [[2, "a_0", INK], [2, "a_1", BLUE], [2, "a_2", VERMILION, [6, 3]], [2, "a_3", GREEN, [2, 3]],
            [2, "a_4", BLUE, [2, 3]]],
  },
  { title: "Valve current", unit: "mA", span: 4, lines: [[0, "current", BLUE]] },
  { title: "Correction of the filter", unit: "mA", span: 0.4, lines: [[1, "correction", VERMILION]] },
  {
    title: "Certificate M_c", unit: "1/s, holds at 0 or less", span: 0.01,
    lines: [[1, "without correction", VERMILION, [6, 3]], [1, "with correction", GREEN]],
  },
  { title: "Pressures", unit: "bar", span: 4, lines: [[0, "pressure a", BLUE], [0, "pressure b", VERMILION, [6, 3]]] },
  { title: "Position", unit: "mm", span: 1, lines: [[0, "position", BLUE]] },
];

export function shown(value) {
  if (!Number.isFinite(value)) return "-";
  const size = Math.abs(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3);
}

function swatch(colour, dash) {
  const pattern = dash ? ` stroke-dasharray="${dash.join(" ")}"` : "";
  return `<svg viewBox="0 0 26 8"><path d="M0 4H26" stroke="${colour}" stroke-width="2.5"${pattern}/></svg>`;
}

// Bands over the whole height; `bands` are [from, to, tripped] in seconds.
function shade(plot, bands) {
  const { ctx, bbox } = plot;
  ctx.save();
  for (const [from, to, tripped] of bands) {
    const left = Math.max(plot.valToPos(from, "x", true), bbox.left);
    const right = Math.min(plot.valToPos(to, "x", true), bbox.left + bbox.width);
    if (right <= left) continue;
    ctx.fillStyle = colour("disarmed");
    if (!tripped) {
      ctx.fillRect(left, bbox.top, right - left, bbox.height);
      continue;
    }
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, bbox.top, right - left, bbox.height);
    ctx.clip();
    ctx.setLineDash([]);
    ctx.strokeStyle = colour("tripped");
    ctx.lineWidth = 4;
    for (let x = left - bbox.height; x < right; x += 10) {
      ctx.beginPath();
      ctx.moveTo(x, bbox.top + bbox.height);
      ctx.lineTo(x + bbox.height, bbox.top);
      ctx.stroke();
    }
    ctx.restore();
  }
  ctx.restore();
}

const AXIS = {
  stroke: colour("soft"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("line"), width: 1 },
  font: "11px system-ui",
};

// Upright lines where something happened, and where a person looks; `marks` are [time, colour].
function mark(plot, marks) {
  const { ctx, bbox } = plot;
  const { min, max } = plot.scales.x;
  ctx.save();
  ctx.lineWidth = 1.5;
  ctx.setLineDash([]);
  for (const [time, colour] of marks) {
    if (time < min || time > max) continue;
    const x = plot.valToPos(time, "x", true);
    ctx.strokeStyle = colour;
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
  }
  ctx.restore();
}

class Plot {
  constructor(place, settings, bands, marks) {
    this.settings = settings;
    this.span = [-1, 0]; // s, until it is drawn
    this.box = document.createElement("div");
    this.box.className = settings.wide ? "plot wide" : "plot";
    this.title = document.createElement("h3");
    this.title.innerHTML = `<span>${settings.title} <small>[${settings.unit}]</small></span>` + settings.lines
      .map(([, name, colour, dash]) => `<span class="value">${swatch(colour, dash)}${name} <b></b></span>`).join("");
    this.values = this.title.querySelectorAll("b");
    this.box.append(this.title);
    place.append(this.box);
    const range = (_, low, high) => {
      if (low === null) return [-settings.span / 2, settings.span / 2];
      const half = Math.max(high - low, settings.span) * 0.55;
      return [(low + high) / 2 - half, (low + high) / 2 + half];
    };
    this.uplot = new uPlot({
      width: this.width(), height: HEIGHT, legend: { show: false }, cursor: { show: false }, padding: [6, 12, 0, 0],
      scales: { x: { time: false, range: () => this.span }, y: { range } },
      axes: [
        { ...AXIS, size: 28, values: (_, ticks) => ticks.map((tick) => `${tick} s`) },
        { ...AXIS, size: 52 },
      ],
      series: [{}, ...settings.lines.map(([, , stroke, dash]) => ({ stroke, dash, width: 1.5, points: { show: false } }))],
      hooks: { drawClear: [(plot) => shade(plot, bands()), (plot) => mark(plot, marks())] },
    }, null, this.box);
  }

  width() {
    return Math.max(200, this.box.clientWidth - 18);
  }

  draw(series, times, end, groups, stride, span, at) {
    this.span = span;
    const lines = this.settings.lines;
    this.box.hidden = !lines.some(([n, name]) => series[n].shown.has(series[n].index(name)));
    if (this.box.hidden) return;
    if (this.uplot.width !== this.width()) this.uplot.setSize({ width: this.width(), height: HEIGHT });
    this.uplot.setData([times, ...lines.map(([n, name]) => series[n].envelope(name, end, groups, stride))]);
    lines.forEach(([n, name], line) => { this.values[line].textContent = shown(series[n].at(name, at)); });
  }
}

export class Plots {
  constructor(place) {
    this.place = place;
    this.seconds = 10;
    this.bands = [];
    this.marks = [];
    this.plots = PLOTS.map((settings) => new Plot(place, settings, () => this.bands, () => this.marks));
  }

  // The last `seconds` before bin `end`. Times count from bin `origin`; the figures are those of bin `at`.
  draw(series, binWidth, end = series[0].end, origin = end, at = end - 1) {
    const all = Math.round(this.seconds / binWidth);
    const stride = Math.max(1, Math.ceil(all / (2 * POINTS)));
    const groups = Math.floor(all / stride);
    const last = (end - origin) * binWidth;
    const times = Array.from({ length: 2 * groups }, (_, n) => last + (Math.floor(n / 2) - groups + (n % 2) / 2) * stride * binWidth);
    this.bands = shaded(series[0], end, groups, stride, binWidth, last);
    const span = [last - this.seconds, last];
    for (const plot of this.plots) plot.draw(series, times, end, groups, stride, span, at);
  }
}

// Where the plant was not armed: [from, to, tripped], in seconds; bin `end` is at `last`.
export function shaded(states, end, groups, stride, binWidth, last) {
  const armed = states.envelope("armed", end, groups, stride);
  const tripped = states.envelope("tripped", end, groups, stride);
  const kind = (g) => {
    if (armed[2 * g] === null) return "";
    return Math.max(tripped[2 * g], tripped[2 * g + 1]) > 0 ? "tripped" : armed[2 * g] + armed[2 * g + 1] < 2 ? "off" : "";
  };
  const bands = [];
  for (let g = 0; g < groups; g++) {
    const now = kind(g);
    const before = bands.at(-1);
    const [from, to] = [last + (g - groups) * stride * binWidth, last + (g + 1 - groups) * stride * binWidth];
    if (!now) continue;
    if (before && before[1] >= from - 1e-9 && before[2] === (now === "tripped")) before[1] = to;
    else bands.push([from, to, now === "tripped"]);
  }
  return bands;
}

// The learner's curves: RMSE of each episode, and the losses behind it.
const CURVES = [
  ["RMSE [N]", [["rmse", BLUE, "RMSE"]]],
  ["loss", [["critic_loss", GREEN, "critics"], ["actor_loss", VERMILION, "actor"]]],
];

export class Curve {
  constructor(place) {
    this.place = place;
    this.plots = new Map();
  }

  draw(curve) {
    if (!curve.episode.length) return;
    for (const [label, lines] of CURVES) {
      if (!lines.some(([key]) => curve[key].some((value) => value !== null))) continue;
      if (!this.plots.has(label)) this.plots.set(label, this.made(label, lines));
      this.plots.get(label).setData([curve.episode, ...lines.map(([key]) => curve[key])]);
    }
  }

  made(label, lines) {
    const width = Math.max(200, this.place.clientWidth);
    return new uPlot({
      width, height: 140, legend: { show: lines.length > 1, live: false }, cursor: { show: false }, scales: { x: { time: false } },
      axes: [{ ...AXIS, size: 38, label: "episode", labelSize: 14, labelFont: "11px system-ui" },
        { ...AXIS, size: 40, label, labelSize: 14, labelFont: "11px system-ui" }],
      series: [{ label: "" }, ...lines.map(([, stroke, name]) => (
        { label: name, stroke, width: 1.5, points: { show: true, size: 5, fill: stroke } }))],
    }, null, this.place);
  }
}
