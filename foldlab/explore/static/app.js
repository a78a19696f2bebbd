// The page's state, and who is asked when it changes.
import { Controls } from "./controls.js";
import { RegimeMap } from "./map.js";
import { Solving } from "./solve.js";
import { Beside, command, save } from "./beside.js";

const token = location.hash.slice(1);
const byId = (id) => document.getElementById(id);

async function fetched(path, body) {
  let answer;
  try {
    answer = await fetch(path, {
      method: "POST",
      headers: { "Content-Type": "application/json", "X-Foldlab-Token": token },
      body: JSON.stringify(body),
    });
  } catch {
    throw new Error("foldlab explore is not running any more: start it again");
  }
  if (!answer.ok) throw new Error((await answer.json()).error);
  return answer;
}
const ask = async (path, body = {}) => (await fetched(path, body)).json();
const file = async (path, body) => (await fetched(path, body)).blob();

// Runs one question at a time; of those asked meanwhile the last.
function latest(run) {
  let busy = false, again = false;
  async function go() {
    if (busy) { again = true; return; }
    busy = true;
    do { again = false; await run(); } while (again);
    busy = false;
  }
  return Object.assign(go, { busy: () => busy });
}

export const degrees = (rad, digits = 3) => `${Number(((rad * 180) / Math.PI).toPrecision(digits))}°`;

// The design that was answered last, and what was said of it.
const page = { answer: null, design: null, trouble: "" };

function trouble(text) {
  page.trouble = text;
  byId("trouble").hidden = !text;
  byId("trouble").textContent = text || "";
  byId("verdict").classList.toggle("stale", Boolean(text));
}

const WORDS = {
  true: ["folds", "✓", "Folds"], false: ["stays", "✗", "Does not fold"], null: ["unsure", "?", "Don’t know"],
};
let saying = 0, said = 0, asking = 0;
const REST = 600; // ms without a change, after which what takes longer is asked

// What the materials' ranges leave open: two hundred rods, so not at every move.
function ranges(design) {
  clearTimeout(asking);
  const box = byId("verdict").querySelector(".ranges");
  box.textContent = "";
  asking = setTimeout(async () => {
    const told = await ask("/api/ranges", design).catch(() => ({}));
    if (page.design === design && told.said) box.textContent = `Over the materials’ ranges: ${told.said}.`;
  }, REST);
}

function show(a, clamped) {
  const [kind, sign, word] = WORDS[a.foldable];
  const box = byId("verdict");
  box.className = kind;
  box.querySelector(".sign").textContent = sign;
  box.querySelector("strong").textContent = word;
  box.querySelector(".bar i").style.width = `${100 * a.probability}%`;
  const early = a.probability === null;
  const off = a.fold_angle_error ? ` ± ${degrees(a.fold_angle_error, 2)}` : "";
  const angle = a.fold_angle === null ? "no angle" : `angle ${degrees(a.fold_angle)}${off}`;
  const chance = early ? "by a rod, while the models are being loaded" : `chance of folding ${(100 * a.probability).toFixed(1)} %`;
  const numbers = `${chance}, ${angle}; ${degrees(a.need)} count as folded`;
  box.querySelector(".numbers").textContent = numbers;
  box.querySelector(".why").textContent = a.rod ? `A rod says: ${a.rod.reason}.` : "A rod does not know such units.";
  const care = [];
  if (early) { box.querySelector(".care").textContent = ""; return; }
  if (a.foldable === null) care.push("Too near the boundary for an answer that is right as often as stated: solve it.");
  if (a.fold_angle > Math.PI) care.push("Panels would meet at about 180° and pass through each other: solve it.");
  if (clamped.length) care.push(`Brought to the bounds of the groups: ${clamped.join(", ")}.`);
  if (a.outside.length) care.push(`Outside of what the models learned (${a.outside.join(", ")}): they guess.`);
  if (a.nearest_foldable !== null)
    care.push(`Nearest label ${a.nearest_foldable ? "folds" : "does not fold"}, ${(100 * a.nearest_distance).toFixed(1)} % of the bounds away.`);
  box.querySelector(".cover").textContent = a.coverage === null ? ""
    : `Of fresh designs of either kind at least ${100 * a.coverage} % are not told the other.`;
  box.querySelector(".care").textContent = care.join(" ");
  clearTimeout(saying);
  saying = setTimeout(() => { byId("live").textContent = `${word}: ${numbers}`; }, 400);
}


async function start() {
  const facts = await ask("/api/facts");
  const controls = new Controls(facts, () => { refresh(); });
  const map = new RegimeMap(byId("map"), controls);
  page.controls = controls;
  const solving = new Solving(ask, file, page);
  const beside = new Beside(page, solving, map);
  byId("save").addEventListener("click", () => save(page, solving));

  const redraw = latest(async () => {
    const design = controls.design();
    const key = map.key(design);
    if (key === map.drawn) { map.point(); return; }
    try {
      map.draw(await ask("/api/map", { design, x: map.x, y: map.y }), key);
    } catch (error) { map.clear(error.message); }
  });
  const answer = latest(async () => {
    const asked = structuredClone(controls.design());
    try {
      const told = await ask("/api/answer", asked);
      page.answer = told;
      page.design = asked;
      trouble("");
      controls.told(told, asked);
      show(told, controls.clamped);
      byId("command").textContent = command(asked, told);
      solving.newDesign();
      beside.refresh();
      if (told.probability === null) { setTimeout(answer, 250); return; }
      byId("verdict").dataset.by = "models";
      ranges(asked);
    } catch (error) { trouble(error.message); return; } finally { said += 1; byId("verdict").dataset.answers = said; }
    redraw();
  });
  // The design as it is set now, answered.
  page.settled = async () => {
    while (answer.busy()) await new Promise((done) => setTimeout(done, 20));
    if (page.trouble) throw new Error(page.trouble);
    return page.design;
  };
  function refresh() { map.point(); answer(); }
  map.changed = redraw;
  refresh();
  document.documentElement.dataset.ready = "yes";
}

start().catch((error) => trouble(error.message));
