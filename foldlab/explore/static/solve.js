// A job of the solver: started, watched, cancelled, and what came of it.
import { shown } from "./controls.js";
import { Shape } from "./shape.js";

const byId = (id) => document.getElementById(id);
const number = (v, d = 3) => (v === null || v === undefined ? "–" : String(Number(v.toPrecision(d))));
const degrees = (rad, d = 3) => `${number((rad * 180) / Math.PI, d)}°`;
const YES = { true: "yes", false: "no", null: "unknown" };
const later = (ms) => new Promise((done) => setTimeout(done, ms));

// What is said of a path, by heading.
export function facts(a) {
  const off = a.error_m1 === null ? "" : ` ± ${degrees(a.error_m1, 2)}`;
  const angle = a.fold_angle === null ? "–" : `${degrees(a.fold_angle)}${off}; ${degrees(a.need)} count as folded`;
  const strain = Object.entries(a.strain).map(([layer, s]) => {
    const limit = s.says ? ` (${s.says}: its limit is ${number(100 * s.low)} to ${number(100 * s.high)} %)` : "";
    return `${layer} ${number(100 * s.peak, 2)} %${limit}`;
  });
  const events = a.events.map((e) => `${e.kind} at ${number(100 * e.contraction)} %`);
  return {
    "folds, by the solver": YES[a.foldable],
    why: a.reason,
    angle,
    "stable; tips over if let go": `${YES[a.stable]}; ${YES[a.topples]}`,
    "panels touch": a.contact ? YES[a.touches] : "not asked: they pass through each other",
    "peak strain": strain.join(", ") || "–",
    "on the way": events.join(", ") || "nothing",
    cost: `${number(a.core_seconds)} core-seconds, ${a.unknowns ?? "–"} unknowns`,
  };
}

export function list(home, told) {
  home.replaceChildren(...Object.entries(told).flatMap(([name, text]) => {
    const [dt, dd] = [document.createElement("dt"), document.createElement("dd")];
    [dt.textContent, dd.textContent] = [name, text];
    return [dt, dd];
  }));
}

export function download(name, blob) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

export class Solving {
  constructor(ask, file, page) {
    this.ask = ask;
    this.file = file;
    this.page = page;
    this.answer = null; // of the solver, and the design that it is of
    this.solved = null;
    this.changed = this.moved = () => {};
    this.shape = new Shape(byId("shape"));
    byId("solve").addEventListener("click", () => this.solve());
    byId("cancel").addEventListener("click", () => this.cancel());
    byId("mend").addEventListener("click", () => this.mend());
    byId("export").addEventListener("click", () => this.export());
    byId("frame").addEventListener("input", () => this.frame());
    byId("colours").addEventListener("change", () => this.frame());
    document.addEventListener("keydown", (e) => {
      if (e.key === "Enter" && (e.ctrlKey || e.metaKey) && !byId("solve").disabled) this.solve();
    });
  }

  // Of the design as it is set now; throws what is wrong with it.
  async options() {
    return {
      design: await this.page.settled(), contact: byId("contact").checked,
      accuracy: Number(byId("accuracy").value), seconds: Number(byId("budget").value),
    };
  }

  say(text, wrong = false) {
    byId("job").textContent = text;
    byId("job").classList.toggle("wrong", wrong);
  }

  busy(yes) {
    for (const button of document.querySelectorAll("button.job, #solve")) button.disabled = yes;
    if (!yes) byId("cancel").disabled = true;
  }

  async cancel() {
    try { await this.ask("/api/cancel", { job: this.job }); } catch (error) { this.say(error.message, true); }
  }

  // The answer of a job and what was asked, or null where there is no answer.
  async run(kind, doing, changes = {}) {
    this.busy(true);
    try {
      const asked = { ...(await this.options()), ...changes };
      let state = await this.ask("/api/start", { kind, asked });
      this.job = state.job;
      byId("cancel").disabled = false;
      while (state.running) {
        this.say(`${doing}: ${state.said}, ${state.seconds.toFixed(0)} s …`);
        await later(state.seconds < 3 ? 150 : 500);
        state = await this.ask("/api/job", { job: state.job });
      }
      this.say(state.error ?? `Done in ${number(state.seconds, 2)} s.`, Boolean(state.error));
      return state.answer && [state.answer, asked];
    } catch (error) {
      this.say(error.message, true);
      return null;
    } finally { this.busy(false); }
  }

  async solve() {
    const done = await this.run("solve", "Solving");
    if (done) this.show(...done);
  }

  show(answer, asked) {
    this.answer = answer;
    this.solved = asked.design;
    byId("shapes").hidden = false;
    list(byId("solved"), facts(answer));
    byId("frame").max = Math.max(0, answer.frames.length - 1);
    byId("frame").value = byId("frame").max;
    this.newDesign();
    this.frame();
    this.changed();
  }

  // Whether the path shown is that of the design that is set.
  get current() { return JSON.stringify(this.solved) === JSON.stringify(this.page.design); }

  newDesign() {
    byId("caption").textContent = this.current ? "This design" : "An earlier design: solve again for this one";
    byId("shapes").classList.toggle("earlier", !this.current);
  }

  async mend() {
    byId("mended").hidden = true;
    const done = await this.run("mend", "Making it fold", { contact: false });
    if (!done) return;
    const [told] = done;
    byId("mended").hidden = false;
    byId("mended").querySelector("p").textContent = `${told.said[0].toUpperCase()}${told.said.slice(1)}.`;
    byId("mended").querySelector("ul").replaceChildren(...told.options.map((option) => this.option(option)));
  }

  option(option) {
    const { sizes, groups } = this.page.controls.facts, item = document.createElement("li");
    const parameters = option.design.quantities ? sizes : groups;
    const changes = option.changes.map(({ name, from, to }) => {
      const p = parameters.find((q) => q.name === name);
      return `${option.design.quantities ? name : p.symbol} from ${shown(p, from)} to ${shown(p, to)}`;
    });
    const off = option.error_m1 === null ? "" : ` ± ${degrees(option.error_m1, 2)}`;
    item.textContent = `${changes.join(", ")}: folds by ${degrees(option.fold_angle)}${off}, confirmed by the solver. `;
    const take = Object.assign(document.createElement("button"), { type: "button", textContent: "Take it" });
    take.setAttribute("aria-label", `Take ${changes.join(", ")}`);
    take.addEventListener("click", () => this.page.controls.take(option.design));
    item.append(take);
    return item;
  }

  async export() {
    const done = await this.run("export", "Exporting");
    if (!done) return;
    const [told] = done;
    try {
      download(told.name, await this.file("/api/file", { job: this.job }));
      this.say(`${told.name}, ${number(told.bytes / 1e6, 2)} MB, is in your downloads.`);
    } catch (error) { this.say(error.message, true); }
  }

  frame() {
    const a = this.answer;
    if (!a || !a.frames.length) return;
    const frame = a.frames[byId("frame").value];
    const says = `${number(100 * frame.contraction)} %: angle ${degrees(frame.m1)}`;
    byId("frame-says").textContent = says;
    byId("frame").setAttribute("aria-valuetext", says);
    this.shape.draw(a, frame, byId("colours").value, this.most?.());
    this.moved();
  }
}
