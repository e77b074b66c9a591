// SPDX-License-Identifier: Apache-2.0
// Bins as the dashboard thins them, a minute of them by default: least and greatest value of each; memory is bounded.

export const KEPT = 6000;

export class Series {
  constructor(columns, kept = KEPT) {
    this.columns = columns; // [{name, unit}]
    this.kept = kept; // bins
    this.low = columns.map(() => new Float32Array(kept).fill(NaN));
    this.high = columns.map(() => new Float32Array(kept).fill(NaN));
    this.end = 0; // number of the first bin that is not there yet
    this.shown = new Set(); // numbers of the columns that have ever had a value
  }

  // Enter closed bins; those that were dropped on the way stay gaps.
  add(first, values) {
    const width = this.columns.length;
    const count = values.length / (2 * width);
    if (!count) return;
    if (first < this.end - this.kept || first > this.end + this.kept) this.clear(first);
    for (let bin = this.end; bin < first; bin++) this.blank(bin);
    for (let n = 0; n < count; n++) {
      const row = (first + n) % this.kept;
      for (let c = 0; c < width; c++) {
        this.low[c][row] = values[2 * (n * width + c)];
        if (!Number.isNaN(this.low[c][row])) this.shown.add(c);
        this.high[c][row] = values[2 * (n * width + c) + 1];
      }
    }
    this.end = Math.max(this.end, first + count);
  }

  clear(end) {
    for (const ring of [...this.low, ...this.high]) ring.fill(NaN);
    this.end = end;
  }

  blank(bin) {
    for (const ring of [...this.low, ...this.high]) ring[bin % this.kept] = NaN;
  }

  index(name) {
    return this.columns.findIndex((column) => column.name === name);
  }

  // The value of a bin, or NaN.
  at(name, bin) {
    const there = bin >= 0 && bin < this.end && bin >= this.end - this.kept;
    return there ? this.high[this.index(name)][bin % this.kept] : NaN;
  }

  // Two points per `stride` bins before bin `end`, in the order that keeps a slope a slope: [points of `groups`].
  envelope(name, end, groups, stride) {
    const c = this.index(name);
    const out = new Array(2 * groups);
    let before = NaN;
    for (let g = 0; g < groups; g++) {
      let low = Infinity;
      let high = -Infinity;
      const start = end - (groups - g) * stride;
      for (let bin = start; bin < start + stride; bin++) {
        if (bin < 0 || bin >= this.end || bin < this.end - this.kept) continue;
        const row = bin % this.kept;
        if (this.low[c][row] < low) low = this.low[c][row];
        if (this.high[c][row] > high) high = this.high[c][row];
      }
      const there = low <= high;
      const falls = 0.5 * (low + high) < before;
      out[2 * g] = there ? (falls ? high : low) : null;
      out[2 * g + 1] = there ? (falls ? low : high) : null;
      before = there ? 0.5 * (low + high) : NaN;
    }
    return out;
  }
}

// A binary message: u32 series, u32 columns, f64 first bin, float32 values (bins, columns, 2), little endian.
export function decoded(buffer) {
  const head = new DataView(buffer);
  return { series: head.getUint32(0, true), first: head.getFloat64(8, true), values: new Float32Array(buffer, 16) };
}
