// Small live plots over the last seconds, on canvas. A hand's width each; the newest value stands in the legend.

const SPAN_MS = 20000;
const REDRAW_MS = 1050; // of all plots, one after another: without a GPU each costs a fifth of a picture, for what the
// screen shows is put together anew from the picture's corner to the plot's
const SAMPLE_MS = 100; // about a pixel of a plot
const STAGE_COLOURS = ["--s1", "--s2", "--s3", "--s4", "--s5", "--s6", "--s7", "--s8"];

const PLOTS = [
  { title: "Rate", unit: "Mbps", series: [["goodput", "goodput_mbps", "--s1"], ["capacity", "capacity_mbps", "--s2"]] },
  { title: "Quality", unit: "dB", floor: false, hint: () => (document.getElementById("score").checked ? "measuring …" : "turn on PSNR"), series: [["restored", "psnr_restored_db", "--s3"], ["aligned", "psnr_aligned_db", "--s2"], ["distorted", "psnr_distorted_db", "--s5"]] },
  { title: "Frame time", unit: "ms", stages: true, series: [] },
  { title: "Detail", unit: "LoD", series: [["mean in view", "lod_mean", "--s4"]] },
  { title: "Prediction error", unit: "°", series: [["angle", "prediction_error_deg", "--s5"]] },
  { title: "Latency", unit: "ms", hint: () => "drag the picture", series: [["drag to photon", "photon_ms", "--s1"]] },
  { title: "Buffer", unit: "ms", series: [["ahead", "buffer_ms", "--s6"]] },
];

export class Plots {
  #samples = [];
  #plots;
  #drawn = 0;
  #next = 0;
  #colours = new Map();
  #hover = null;

  constructor(host) {
    this.#plots = PLOTS.map((plot) => this.#build(host, plot));
  }

  /** Take the figures of one frame: {name: number | null}; `stages` {name: ms}. The newest of a moment stays. */
  add(now, stats, stages) {
    const last = this.#samples.at(-2);
    if (last && now - last.t < SAMPLE_MS) this.#samples.pop();
    this.#samples.push({ t: now, stats, stages });
    while (this.#samples.length && this.#samples[0].t < now - SPAN_MS) this.#samples.shift();
    if (now - this.#drawn < REDRAW_MS / this.#plots.length) return;
    this.#drawn = now;
    this.#next = (this.#next + 1) % this.#plots.length;
    this.#draw(this.#plots[this.#next], now);
  }

  /** All of them, in the colours of the theme as it is now. */
  draw(now = performance.now()) {
    this.#colours.clear();
    for (const plot of this.#plots) this.#draw(plot, now);
  }

  #colour(name) {
    if (!this.#colours.has(name))
      this.#colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
    return this.#colours.get(name);
  }

  #build(host, plot) {
    const box = document.createElement("div");
    box.className = plot.stages ? "plot wide" : "plot";
    const legend = document.createElement("div");
    legend.className = "legend";
    const canvas = document.createElement("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${plot.title} in ${plot.unit}, last 20 seconds`);
    canvas.addEventListener("pointermove", (event) => {
      this.#hover = 1 - event.offsetX / canvas.clientWidth;
      this.draw();
    });
    canvas.addEventListener("pointerleave", () => (this.#hover = null));
    box.append(legend, canvas);
    host.append(box);
    const built = { ...plot, legend, canvas, context: canvas.getContext("2d"), size: [1, 1] };
    new ResizeObserver(([entry]) => (built.size = [entry.contentRect.width, entry.contentRect.height])).observe(canvas);
    return built;
  }

  #seriesOf(plot) {
    if (!plot.stages) return plot.series.map(([label, key, colour]) => ({ label, colour, get: (s) => s.stats[key] }));
    const names = [...new Set(this.#samples.slice(-30).flatMap((s) => Object.keys(s.stages)))];
    return names.map((label, i) => ({
      label,
      colour: STAGE_COLOURS[i % STAGE_COLOURS.length],
      get: (s) => (label in s.stages ? names.slice(0, i + 1).reduce((sum, n) => sum + (s.stages[n] ?? 0), 0) : null),
      own: (s) => s.stages[label],
    }));
  }

  #draw(plot, now) {
    const colour = (name) => this.#colour(name);
    const series = this.#seriesOf(plot).filter((one) => this.#samples.some((s) => Number.isFinite(one.get(s))));
    this.#legend(plot, series, now, colour);
    const { canvas, context } = plot;
    const [w, h] = plot.size.map((side) => Math.max(1, Math.round(side * devicePixelRatio)));
    if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
    context.clearRect(0, 0, w, h);
    const values = series.flatMap((one) => this.#samples.map(one.get)).filter(Number.isFinite);
    const [low, high] = range(values, plot.floor !== false);
    const x = (t) => w * (1 - (now - t) / SPAN_MS);
    const y = (v) => h - 2 - ((v - low) / (high - low)) * (h - 14 * devicePixelRatio);
    this.#grid(context, w, h, low, high, y, colour);
    for (const one of plot.stages ? [...series].reverse() : series) this.#line(context, one, x, y, h, colour, plot.stages);
    if (this.#hover !== null) {
      context.fillStyle = colour("--muted");
      context.fillRect(Math.round(w * (1 - this.#hover)), 0, Math.max(1, devicePixelRatio), h);
    }
  }

  #grid(context, w, h, low, high, y, colour) {
    context.fillStyle = colour("--grid");
    context.fillRect(0, h - devicePixelRatio, w, devicePixelRatio);
    context.fillRect(0, y(high), w, devicePixelRatio);
    context.fillStyle = colour("--muted");
    context.font = `${10 * devicePixelRatio}px system-ui, sans-serif`;
    context.fillText(brief(high), 1, y(high) - 3 * devicePixelRatio);
    if (low > 0) context.fillText(brief(low), 1, h - 4 * devicePixelRatio);
  }

  #line(context, one, x, y, h, colour, filled) {
    context.beginPath();
    let pen = false;
    let [first, last] = [0, 0];
    for (const sample of this.#samples) {
      const value = one.get(sample);
      if (!Number.isFinite(value)) {
        pen = false;
        continue;
      }
      last = x(sample.t);
      if (!pen) first = last;
      context[pen ? "lineTo" : "moveTo"](last, y(value));
      pen = true;
    }
    if (filled) {
      context.lineTo(last, h);
      context.lineTo(first, h);
      context.fillStyle = colour(one.colour);
      context.fill();
      return;
    }
    context.strokeStyle = colour(one.colour);
    context.lineWidth = 1.6 * devicePixelRatio;
    context.lineJoin = "round";
    context.stroke();
  }

  #legend(plot, series, now, colour) {
    const at = this.#hover === null ? this.#samples.at(-1) : this.#near(now - this.#hover * SPAN_MS);
    const hint = plot.hint?.() ?? "nothing yet";
    const names = series.map((one) => one.label).join() || hint;
    if (plot.names !== names) {
      plot.names = names;
      plot.values = series.map(() => element("b"));
      const title = element("strong", `${plot.title} `, note(plot.unit));
      const entries = series.map((one, i) => element("span", element("i"), `${one.label} `, plot.values[i]));
      plot.legend.replaceChildren(title, ...(entries.length ? entries : [element("span", hint)]));
    }
    series.forEach((one, i) => {
      const value = at ? (one.own ?? one.get)(at) : null;
      plot.values[i].textContent = Number.isFinite(value) ? brief(value) : "–";
      plot.values[i].parentElement.firstChild.style.background = colour(one.colour);
    });
  }

  #near(t) {
    return this.#samples.reduce((best, s) => (Math.abs(s.t - t) < Math.abs((best?.t ?? 1e18) - t) ? s : best), null);
  }
}

function range(values, fromZero) {
  if (!values.length) return [0, 1];
  const high = Math.max(...values);
  if (fromZero) return [0, Math.max(high, 1e-3)];
  const low = Math.min(...values);
  return [low - 0.5, Math.max(high, low + 1)];
}

export function brief(value) {
  const size = Math.abs(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : 2);
}

function element(name, ...children) {
  const node = document.createElement(name);
  node.append(...children);
  return node;
}

function note(text) {
  const node = element("span", text);
  node.className = "note";
  return node;
}
