// Sliders and their texts: by materials and sizes, or by groups.
const byId = (id) => document.getElementById(id);
const STEPS = 200;
// SI units as a maker reads them: how many of them make one, and the sign.
const SHOWN = { m: [1e3, "mm"], Pa: [1e-6, "MPa"], "kg/m³": [1, "kg/m³"], 1: [1, ""] };

const log = (p) => p.scale === "log";
export function unitOf(p, value) {
  return log(p) ? Math.log(value / p.low) / Math.log(p.high / p.low) : (value - p.low) / (p.high - p.low);
}
export function fromUnit(p, at) {
  const u = Math.min(1, Math.max(0, at));
  return log(p) ? p.low * (p.high / p.low) ** u : p.low + u * (p.high - p.low);
}
export function digits(value) {
  const text = Number(value.toPrecision(3));
  return Math.abs(text) >= 1e5 || Math.abs(text) < 1e-3 ? text.toExponential().replace("e+", "e") : String(text);
}
function shownIn(p) { return p.name === "contraction" ? [100, "%"] : SHOWN[p.unit]; }
export function shown(p, value) {
  const [factor, sign] = shownIn(p);
  return sign ? `${digits(value * factor)} ${sign}` : digits(value);
}
export const signOf = (p) => shownIn(p)[1];
export const factorOf = (p) => shownIn(p)[0];

export class Controls {
  constructor(facts, changed) {
    this.facts = facts;
    this.changed = changed;
    this.mode = "sizes";
    this.given = { ...facts.first.quantities };
    this.passive = facts.first.passive;
    this.active = facts.first.active;
    this.groups = {};
    this.clamped = []; // groups that had to come to a bound
    this.values = { ...this.given };
    for (const role of ["passive", "active"]) {
      const list = byId(role);
      for (const m of facts.materials[role]) list.append(new Option(m.name, m.name));
      list.value = this[role];
      list.addEventListener("change", () => this.material(role, list.value));
    }
    for (const radio of document.querySelectorAll("[name=mode]"))
      radio.addEventListener("change", () => this.turn(radio.value));
    this.build();
  }

  get parameters() { return this.facts[this.mode]; }
  parameter(name) { return this.parameters.find((p) => p.name === name); }

  design() {
    if (this.mode === "sizes") return { quantities: this.given, passive: this.passive, active: this.active };
    return { groups: this.groups, passive: this.passive };
  }

  value(name) { return this.values[name]; }

  // By slider, map or keyboard.
  set(changes) {
    this.clamped = [];
    const kept = this.mode === "sizes" ? this.given : this.groups;
    for (const [name, value] of Object.entries(changes)) {
      kept[name] = value;
      this.values[name] = value;
      this.row(name, value);
    }
    this.changed();
  }

  material(role, name) {
    this[role] = name;
    const own = role === "passive" ? ["E_s", "rho_s"] : ["E_i", "rho_i", "contraction"];
    if (this.mode === "sizes") for (const q of own) delete this.given[q];
    this.changed();
  }

  turn(mode) {
    const told = this.last;
    if (!told) return;
    this.mode = mode;
    if (mode === "groups") {
      this.groups = {};
      // The last digit of a conversion may lie beyond a bound; what is far out comes to its end.
      for (const p of this.parameters) this.groups[p.name] = Math.min(p.high, Math.max(p.low, told.groups[p.name]));
      const off = (p) => Math.abs(this.groups[p.name] / told.groups[p.name] - 1) > 1e-6;
      this.clamped = this.parameters.filter(off).map((p) => p.symbol);
      this.values = { ...this.groups };
    } else {
      const { g_earth, ...physical } = told.physical;
      this.given = physical;
      this.clamped = [];
      this.values = { ...physical };
    }
    byId("active-row").hidden = mode === "groups";
    this.build();
    this.rebuilt?.();
    this.changed();
  }

  // Whole designs, as from a proposal.
  take(design) {
    if (design.quantities) {
      this.mode = "sizes";
      this.given = { ...design.quantities };
      this.passive = design.passive ?? this.passive;
      this.active = design.active ?? this.active;
      byId("passive").value = this.passive;
      byId("active").value = this.active;
    } else {
      this.mode = "groups";
      this.groups = { ...design.groups };
    }
    this.values = { ...(design.quantities ?? design.groups) };
    document.querySelector(`[name=mode][value=${this.mode}]`).checked = true;
    byId("active-row").hidden = this.mode === "groups";
    this.build();
    this.rebuilt?.();
    this.changed();
  }

  // What the server made of the design: quantities that follow from a material, text with units.
  told(answer, asked) {
    this.last = answer;
    const sent = this.mode === "sizes" ? asked.quantities : asked.groups;
    if (!sent) return; // the other sliders came meanwhile
    const all = this.mode === "sizes" ? answer.physical : answer.groups;
    const kept = this.mode === "sizes" ? this.given : this.groups;
    for (const p of this.parameters) {
      if (typeof kept[p.name] === "string" && kept[p.name] === sent[p.name]) kept[p.name] = all[p.name];
      // While a slider moves on, what it had before is no news.
      if (p.name in kept && kept[p.name] !== all[p.name]) continue;
      this.values[p.name] = all[p.name];
      this.row(p.name, all[p.name]);
    }
  }

  build() {
    const home = byId("sliders");
    home.replaceChildren();
    for (const p of this.parameters) {
      const row = document.createElement("div");
      row.className = "slider";
      row.dataset.name = p.name;
      const id = `s-${p.name}`;
      const label = document.createElement("label");
      label.htmlFor = id;
      label.innerHTML = "<b></b> <span></span>";
      label.firstChild.textContent = this.mode === "sizes" && p.name !== "contraction" ? p.name : p.symbol;
      label.lastChild.textContent = p.meaning;
      const range = Object.assign(document.createElement("input"), { type: "range", id, min: 0, max: STEPS, step: 1 });
      range.addEventListener("input", () => this.set({ [p.name]: fromUnit(p, range.value / STEPS) }));
      const text = Object.assign(document.createElement("input"), { type: "text", spellcheck: false });
      text.setAttribute("aria-label", `${p.meaning}, as a number`);
      text.setAttribute("inputmode", "text");
      text.addEventListener("input", () => { text.dataset.typing = "yes"; });
      text.addEventListener("change", () => { delete text.dataset.typing; this.typed(p, text); });
      row.append(label, range, text);
      home.append(row);
      if (this.values[p.name] !== undefined) this.row(p.name, this.values[p.name]);
    }
  }

  typed(p, text) {
    const said = text.value.trim();
    const bare = /^[-+]?[\d.]+(e[-+]?\d+)?$/i.test(said);
    const value = bare ? Number(said) / factorOf(p) : said;
    const kept = this.mode === "sizes" ? this.given : this.groups;
    kept[p.name] = value;
    if (bare) this.values[p.name] = value;
    this.changed();
  }

  row(name, value) {
    const p = this.parameter(name), row = byId("sliders").querySelector(`[data-name="${name}"]`);
    if (!row || typeof value !== "number") return;
    const [range, text] = row.querySelectorAll("input");
    const at = unitOf(p, value);
    if (document.activeElement !== range || Math.abs(range.value / STEPS - at) > 1 / STEPS)
      range.value = Math.round(at * STEPS);
    range.setAttribute("aria-valuetext", shown(p, value));
    row.classList.toggle("off", at < -1e-6 || at > 1 + 1e-6);
    if (!text.dataset.typing) text.value = shown(p, value);
  }
}
