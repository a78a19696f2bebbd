// A unit in three dimensions, by plotly.js, which is fetched from this machine when first needed.
import { unpacked } from "./map.js";

const COLOURS = { passive: "#9DB4CC", active: "#E2A33B", ground: "#DEDBD3" };
const DECADES = 3; // of strain below the largest that have colours of their own
let loading = null;

export function plotly() {
  loading ??= new Promise((done, failed) => {
    const script = Object.assign(document.createElement("script"), { src: "plotly.js" });
    script.onload = () => done(window.Plotly);
    script.onerror = () => failed(new Error("plotly.js did not come: pip install 'foldlab[explore]'"));
    document.head.append(script);
  });
  return loading;
}

function surface(layer) {
  layer.read ??= {
    points: unpacked(layer.points),
    triangles: unpacked(layer.triangles, Int32Array),
    strain: unpacked(layer.strain),
  };
  return layer.read;
}

const column = (flat, k) => Array.from({ length: flat.length / 3 }, (_, n) => flat[3 * n + k]);

// Half the edges of a cube, and its middle, that hold all frames: the view stays where it is.
function box(frames) {
  const low = [0, 0, 0].fill(Infinity), high = [0, 0, 0].fill(-Infinity);
  for (const frame of frames) for (const layer of Object.values(frame.layers)) {
    const { points } = surface(layer);
    points.forEach((v, n) => {
      low[n % 3] = Math.min(low[n % 3], v);
      high[n % 3] = Math.max(high[n % 3], v);
    });
  }
  return { low, high };
}

// The largest strain in all frames.
export function strained(answer) {
  answer.most ??= Math.max(1e-9, ...answer.frames.flatMap((f) => Object.values(f.layers).map((l) => surface(l).strain.reduce((a, b) => Math.max(a, b), 0))));
  return answer.most;
}

export class Shape {
  constructor(home) {
    this.home = home;
    this.busy = false;
    this.next = null;
    home.tabIndex = 0;
    home.setAttribute("role", "application");
    home.setAttribute("aria-label", "Shape in three dimensions. Arrow keys turn it, plus and minus zoom.");
    home.addEventListener("keydown", (e) => this.turn(e));
    new ResizeObserver(() => { if (this.drawn) window.Plotly.Plots.resize(home); }).observe(home);
  }

  // Draws the last of the frames asked for while it was drawing.
  async draw(answer, frame, colours, most = strained(answer)) {
    this.next = [answer, frame, colours, most];
    if (this.busy) return;
    this.busy = true;
    try {
      const Plotly = await plotly();
      while (this.next) {
        const args = this.next;
        this.next = null;
        await Plotly.react(this.home, ...this.figure(...args), { displaylogo: false, responsive: false,
          modeBarButtons: [["toImage", "resetCameraDefault3d"]] });
        this.drawn = true;
        this.home.dataset.frame = String(args[0].frames.indexOf(args[1]));
      }
    } catch (error) {
      this.home.textContent = error.message;
    } finally { this.busy = false; }
  }

  turn(event) {
    const by = { ArrowLeft: [-1, 0, 1], ArrowRight: [1, 0, 1], ArrowUp: [0, 1, 1], ArrowDown: [0, -1, 1], "+": [0, 0, 1 / 1.1], "-": [0, 0, 1.1] }[event.key];
    if (!by || !this.drawn) return;
    event.preventDefault();
    const { x, y, z } = this.home._fullLayout.scene.camera.eye, step = Math.PI / 24;
    const r = Math.hypot(x, y, z) * by[2], round = Math.atan2(y, x) + step * by[0];
    const up = Math.min(1.5, Math.max(-1.5, Math.asin(z / Math.hypot(x, y, z)) + step * by[1]));
    const eye = { x: r * Math.cos(up) * Math.cos(round), y: r * Math.cos(up) * Math.sin(round), z: r * Math.sin(up) };
    window.Plotly.relayout(this.home, { "scene.camera.eye": eye });
  }

  figure(answer, frame, colours, most) {
    answer.box ??= box(answer.frames);
    const { low, high } = answer.box, traces = [], top = Math.log10(100 * most);
    // Farther off where there is less room.
    const off = this.home.clientWidth < 520 ? 1.9 : 1.4;
    for (const [name, layer] of Object.entries(frame.layers)) {
      const { points, triangles, strain } = surface(layer);
      const trace = {
        type: "mesh3d", name, x: column(points, 0), y: column(points, 1), z: column(points, 2),
        i: column(triangles, 0), j: column(triangles, 1), k: column(triangles, 2),
        flatshading: true, lighting: { ambient: 0.75, diffuse: 0.5, specular: 0.02, roughness: 0.9 },
        hovertemplate: `${name}<extra></extra>`,
      };
      if (colours === "strain") Object.assign(trace, {
        intensitymode: "cell", coloraxis: "coloraxis",
        intensity: Array.from(strain, (s) => Math.log10(Math.max(100 * s, 10 ** (top - DECADES)))),
        customdata: Array.from(strain, (s) => 100 * s),
      });
      else trace.color = COLOURS[name];
      traces.push(trace);
    }
    const pad = 0.08, [x0, y0] = [low[0] - pad, low[1] - pad], [x1, y1] = [high[0] + pad, high[1] + pad], edge = 0.01;
    traces.push({
      type: "mesh3d", name: "ground", x: [x0, x1, x1, x0], y: [y0, y0, y1, y1], z: [-0.002, -0.002, -0.002, -0.002],
      i: [0, 0], j: [1, 2], k: [2, 3], color: COLOURS.ground, hoverinfo: "skip",
      lighting: { ambient: 1, diffuse: 0 },
    });
    const whole = [];
    for (let d = Math.ceil(top - DECADES); d <= top; d++) whole.push(d);
    const hidden = { visible: false };
    return [traces, {
      margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, uirevision: `view ${off}`, paper_bgcolor: "#fff",
      coloraxis: {
        colorscale: "Viridis", cmin: top - DECADES, cmax: top,
        colorbar: {
          title: { text: "elastic strain, %", side: "top" }, orientation: "h", thickness: 10, len: 0.8,
          x: 0.5, y: 0, yanchor: "bottom",
          tickvals: whole, ticktext: whole.map((d) => String(Number((10 ** d).toPrecision(1)))),
        },
      },
      scene: {
        aspectmode: "data", xaxis: { ...hidden, range: [x0 - edge, x1 + edge] }, yaxis: { ...hidden, range: [y0 - edge, y1 + edge] },
        zaxis: { ...hidden, range: [Math.min(low[2], 0) - 0.02, high[2] + 0.02] },
        camera: { eye: { x: off, y: -0.7 * off, z: 0.42 * off } },
      },
    }];
  }
}
