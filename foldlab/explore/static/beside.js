// Two designs beside each other, and what of a design leaves the page.
import { shown } from "./controls.js";
import { Shape, strained } from "./shape.js";
import { download, facts } from "./solve.js";

const byId = (id) => document.getElementById(id);
const degrees = (rad) => `${Number(((rad * 180) / Math.PI).toPrecision(3))}°`;
const WORDS = { true: "folds", false: "does not fold", null: "don’t know" };

export class Beside {
  constructor(page, solving, map) {
    Object.assign(this, { page, solving, map, a: null });
    this.shape = new Shape(byId("shape-a"));
    byId("pin").addEventListener("click", () => this.pin());
    byId("unpin").addEventListener("click", () => this.unpin());
    byId("back").addEventListener("click", () => this.page.controls.take(this.a.design));
    solving.changed = () => this.refresh();
    solving.moved = () => this.frame();
    // One scale of colours for both.
    solving.most = () => Math.max(...[this.a?.solved, solving.answer].filter((s) => s?.frames.length).map(strained));
    byId("same").addEventListener("change", () => this.refresh());
  }

  pin() {
    const { page, solving } = this;
    this.a = { answer: page.answer, design: structuredClone(page.design), solved: solving.current ? solving.answer : null };
    this.map.pinned = { ...page.answer.physical, ...page.answer.groups };
    this.map.point();
    this.refresh();
    this.solving.frame();
  }

  unpin() {
    this.a = this.map.pinned = null;
    this.map.point();
    this.refresh();
  }

  refresh() {
    byId("compare").hidden = !this.a;
    byId("of-a").hidden = !this.a?.solved;
    if (!this.a) return;
    const solved = this.solving.current ? this.solving.answer : null;
    const columns = [this.column(this.a.answer, this.a.solved), this.column(this.page.answer, solved)];
    const differs = (name) => byId("same").checked || columns[0][name] !== columns[1][name];
    const names = [...new Set(columns.flatMap(Object.keys))].filter(differs);
    byId("compare").querySelector("tbody").replaceChildren(...names.map((name) => {
      const row = document.createElement("tr"), texts = columns.map((c) => c[name] ?? "–");
      row.className = texts[0] === texts[1] ? "" : "other";
      const head = Object.assign(document.createElement("th"), { scope: "row", textContent: name });
      row.append(head, ...texts.map((text) => Object.assign(document.createElement("td"), { textContent: text })));
      return row;
    }));
    this.frame();
  }

  column(answer, solved) {
    const { sizes, groups } = this.page.controls.facts;
    const out = {
      "by the models": `${WORDS[answer.foldable]}, chance ${(100 * answer.probability).toFixed(1)} %`,
      "angle by the models": answer.fold_angle === null ? "–" : degrees(answer.fold_angle),
    };
    if (solved) for (const [name, text] of Object.entries(facts(solved))) out[name === "angle" ? "angle by the solver" : name] = text;
    for (const p of groups) out[`${p.symbol}, ${p.meaning}`] = shown(p, answer.groups[p.name]);
    if (answer.physical) for (const p of sizes) out[`${p.name}, ${p.meaning}`] = shown(p, answer.physical[p.name]);
    return out;
  }

  // A at the fraction of its contraction at which the other is.
  frame() {
    const a = this.a?.solved;
    if (!a?.frames.length) return;
    const { value, max } = byId("frame"), own = this.solving.answer;
    const of = (frames, k) => frames[k].contraction / frames.at(-1).contraction;
    const at = own?.frames.length && Number(max) ? of(own.frames, Number(value)) : 1;
    const off = a.frames.map((_, k) => Math.abs(of(a.frames, k) - at));
    const frame = a.frames[off.indexOf(Math.min(...off))];
    byId("of-a").querySelector("figcaption").textContent = `A at ${Number((100 * frame.contraction).toPrecision(3))} %: angle ${degrees(frame.m1)}`;
    this.shape.draw(a, frame, byId("colours").value, this.solving.most());
  }
}

// The same question to the command line.
export function command(design, answer) {
  const set = (values) => Object.entries(values).map(([k, v]) => `--set ${k}=${typeof v === "number" ? Number(v.toPrecision(6)) : v.replace(/\s/g, "")}`);
  if (design.groups) return ["foldlab simulate", ...set(answer.groups)].join(" ");
  return ["foldlab check", ...["passive", "active"].map((r) => `--${r} "${design[r]}"`), ...set(design.quantities)].join(" ");
}

export function save(page, solving) {
  const { groups, physical, materials, ...models } = page.answer;
  const solver = solving.current ? { ...solving.answer, frames: undefined, box: undefined } : null;
  const text = JSON.stringify({ format: "foldlab design 1", groups, physical, materials, models, solver }, null, 1);
  download("foldlab-design.json", new Blob([text], { type: "application/json" }));
}
