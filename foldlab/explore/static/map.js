// The regime map: chance of folding over two sliders, drawn on a canvas, the design a point on it.
import { digits, factorOf, fromUnit, signOf, unitOf } from "./controls.js";

// cividis, which looks the same to the colour-blind.
const CIVIDIS = ["#00224e", "#123570", "#3b496c", "#575d6d", "#707173", "#8a8678", "#a59c74", "#c3b369", "#e1cc55", "#fee838"]
  .map((c) => [1, 3, 5].map((k) => parseInt(c.slice(k, k + 2), 16)));
const MARGIN = { left: 58, right: 22, top: 8, bottom: 42 };
const SVG = "http://www.w3.org/2000/svg";

export function unpacked(text, Kind = Float32Array) {
  const raw = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Kind(raw.buffer);
}

function colour(p) {
  const at = Math.min(1, Math.max(0, p)) * (CIVIDIS.length - 1), k = Math.min(CIVIDIS.length - 2, Math.floor(at));
  return CIVIDIS[k].map((c, i) => c + (at - k) * (CIVIDIS[k + 1][i] - c));
}

// Line pieces on which a field (side × side, at the middles of cells) has a value; in cells.
export function contour(field, side, level) {
  const out = [];
  for (let r = 0; r + 1 < side; r++) for (let c = 0; c + 1 < side; c++) {
    const at = [[c, r], [c + 1, r], [c + 1, r + 1], [c, r + 1]];
    const v = at.map(([i, j]) => field[j * side + i] - level);
    if (v.some(Number.isNaN)) continue;
    const cuts = [];
    for (let k = 0; k < 4; k++) {
      const a = v[k], b = v[(k + 1) % 4];
      if (a < 0 === b < 0) continue;
      const t = a / (a - b), p = at[k], q = at[(k + 1) % 4];
      cuts.push([p[0] + t * (q[0] - p[0]) + 0.5, p[1] + t * (q[1] - p[1]) + 0.5]);
    }
    for (let k = 0; k + 1 < cuts.length; k += 2) out.push([cuts[k], cuts[k + 1]]);
  }
  return out;
}

export class RegimeMap {
  constructor(home, controls) {
    this.home = home;
    this.controls = controls;
    this.canvas = home.querySelector("canvas");
    this.svg = home.querySelector("svg");
    this.lists = { x: document.getElementById("map-x"), y: document.getElementById("map-y") };
    this.changed = () => {};
    this.last = null;
    this.pinned = null;
    for (const [axis, list] of Object.entries(this.lists)) list.addEventListener("change", () => {
      const other = this.lists[axis === "x" ? "y" : "x"];
      if (other.value === list.value) other.value = this[axis];
      [this.x, this.y] = [this.lists.x.value, this.lists.y.value];
      this.changed();
    });
    controls.rebuilt = () => this.choices();
    this.choices();
    home.addEventListener("pointerdown", (e) => {
      home.setPointerCapture(e.pointerId);
      home.focus({ preventScroll: true });
      this.move(e);
    });
    home.addEventListener("pointermove", (e) => { if (home.hasPointerCapture(e.pointerId)) this.move(e); });
    home.addEventListener("keydown", (e) => this.key_pressed(e));
    new ResizeObserver(() => this.paint()).observe(home);
  }

  choices() {
    const sizes = this.controls.mode === "sizes";
    [this.x, this.y] = sizes ? ["h_s", "h_i"] : ["E_ratio", "h_ratio"];
    for (const [axis, list] of Object.entries(this.lists)) {
      list.replaceChildren(...this.controls.parameters.map((p) => new Option(sizes ? `${p.name}, ${p.meaning}` : `${p.symbol}, ${p.meaning}`, p.name)));
      list.value = this[axis];
    }
    this.drawn = null;
  }

  // Two designs of one key have one map.
  key(design) {
    const rest = { ...(design.quantities ?? design.groups) };
    delete rest[this.x];
    delete rest[this.y];
    return JSON.stringify([this.x, this.y, this.controls.mode, design.passive, design.active, rest]);
  }

  get frame() {
    const { width, height } = this.home.getBoundingClientRect();
    return { left: MARGIN.left, top: MARGIN.top, w: width - MARGIN.left - MARGIN.right, h: height - MARGIN.top - MARGIN.bottom };
  }

  move(event) {
    const box = this.home.getBoundingClientRect(), f = this.frame;
    this.set((event.clientX - box.left - f.left) / f.w, 1 - (event.clientY - box.top - f.top) / f.h);
  }

  set(u, v) {
    const [px, py] = [this.x, this.y].map((n) => this.controls.parameter(n));
    this.controls.set({ [this.x]: fromUnit(px, u), [this.y]: fromUnit(py, v) });
  }

  key_pressed(event) {
    const step = event.shiftKey ? 0.1 : 0.02;
    const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    const at = this.place();
    if (!by || !at) return;
    event.preventDefault();
    this.set(at[0] + step * by[0], at[1] + step * by[1]);
  }

  place(values = this.controls.values) {
    const at = [this.x, this.y].map((n) => [this.controls.parameter(n), values[n]]);
    const place = at.map(([p, v]) => (p && typeof v === "number" ? unitOf(p, v) : NaN));
    return place.every(Number.isFinite) ? place : null;
  }

  draw(map, key) {
    // Axes may have been chosen anew since it was asked for.
    if (map.x !== this.x || map.y !== this.y) return;
    this.last = { ...map, probability: unpacked(map.probability), light: unpacked(map.light) };
    this.drawn = key;
    this.paint();
  }

  clear() {
    this.last = this.drawn = null;
    this.paint();
  }

  paint() {
    const f = this.frame, m = this.last;
    if (f.w <= 0) return;
    Object.assign(this.canvas.style, { left: `${f.left}px`, top: `${f.top}px`, width: `${f.w}px`, height: `${f.h}px` });
    this.svg.replaceChildren();
    if (m) {
      this.canvas.width = this.canvas.height = m.side;
      const context = this.canvas.getContext("2d", { willReadFrequently: true }), image = context.createImageData(m.side, m.side);
      m.probability.forEach((p, k) => {
        const row = m.side - 1 - Math.floor(k / m.side), at = 4 * (row * m.side + (k % m.side));
        const [r, g, b] = Number.isNaN(p) ? [255, 255, 255] : colour(p);
        image.data.set([r, g, b, 255], at);
      });
      context.putImageData(image, 0, 0);
      for (const level of new Set([m.folds_from, m.not_up_to])) this.lines(m.probability, level, "#fff", "");
      this.lines(m.light, 0, "#fff", "5 4");
    } else this.canvas.getContext("2d").clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.axes(f);
    this.mark = this.add("g", {});
    this.point();
  }

  add(name, attributes, parent = this.svg) {
    const node = document.createElementNS(SVG, name);
    for (const [k, v] of Object.entries(attributes)) node.setAttribute(k, v);
    parent.append(node);
    return node;
  }

  lines(field, level, halo, dash) {
    const f = this.frame, side = this.last.side;
    const at = ([c, r]) => `${(f.left + (c / side) * f.w).toFixed(1)} ${(f.top + (1 - r / side) * f.h).toFixed(1)}`;
    const d = contour(field, side, level).map(([a, b]) => `M${at(a)}L${at(b)}`).join("");
    this.add("path", { d, fill: "none", stroke: halo, "stroke-width": 3.5 });
    this.add("path", { d, fill: "none", stroke: "#111", "stroke-width": 1.5, "stroke-dasharray": dash });
  }

  axes(f) {
    this.add("rect", { x: f.left, y: f.top, width: f.w, height: f.h, fill: "none", stroke: "#55616e" });
    for (const [axis, name] of [["x", this.x], ["y", this.y]]) {
      const p = this.controls.parameter(name);
      if (!p) return;
      const across = axis === "x";
      for (const value of ticks(p)) {
        const u = unitOf(p, value), text = digits(value * factorOf(p));
        const [x, y] = across ? [f.left + u * f.w, f.top + f.h] : [f.left, f.top + (1 - u) * f.h];
        this.add("line", { x1: x, y1: y, x2: across ? x : x - 4, y2: across ? y + 4 : y, stroke: "#55616e" });
        this.add("text", across ? { x, y: y + 16, "text-anchor": "middle" } : { x: x - 7, y: y + 4, "text-anchor": "end" }).textContent = text;
      }
      const said = `${this.controls.mode === "sizes" ? p.name : p.symbol}${signOf(p) && `, ${signOf(p)}`}`;
      const [x, y] = [f.left + f.w / 2, f.top + f.h / 2];
      this.add("text", across ? { x, y: f.top + f.h + 34, "text-anchor": "middle" }
        : { x: 12, y, "text-anchor": "middle", transform: `rotate(-90 12 ${y})` }).textContent = said;
    }
  }

  point() {
    if (!this.mark) return;
    this.mark.replaceChildren();
    const f = this.frame;
    for (const [at, letter] of [[this.pinned && this.place(this.pinned), "A"], [this.place(), ""]]) {
      if (!at) continue;
      const [u, v] = at.map((a) => Math.min(1, Math.max(0, a)));
      const [cx, cy] = [f.left + u * f.w, f.top + (1 - v) * f.h];
      this.add("circle", { cx, cy, r: 7, fill: letter ? "#fff" : "#d1652c", stroke: "#fff", "stroke-width": 2.5 }, this.mark);
      this.add("circle", { cx, cy, r: 8.5, fill: "none", stroke: "#111", "stroke-width": 1.2 }, this.mark);
      if (letter) this.add("text", { x: cx, y: cy + 4, "text-anchor": "middle" }, this.mark).textContent = letter;
    }
  }
}

function ticks(p) {
  const out = [], shownLow = p.low * factorOf(p), shownHigh = p.high * factorOf(p);
  if (p.scale === "log") {
    for (let e = Math.ceil(Math.log10(shownLow) - 1e-9); e <= Math.log10(shownHigh) + 1e-9; e++) out.push(10 ** e / factorOf(p));
    const thin = Math.ceil(out.length / 5);
    return out.filter((_, k) => k % thin === 0);
  }
  const step = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20].find((s) => (shownHigh - shownLow) / s <= 5);
  for (let v = Math.ceil(shownLow / step) * step; v <= shownHigh + 1e-9; v += step) out.push(v / factorOf(p));
  return out;
}
