// Where curves come from, and the cursor and the window that all views of a page share.
"use strict";
window.VSense = window.VSense || {};

(() => {
  /** Curves of the workbench, asked of its server. A report puts an object with the same methods in its place. */
  class Server {
    async _post(path, body) {
      const answer = await fetch(path, {
        method: "POST", credentials: "same-origin",
        headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
      });
      if (!answer.ok) throw new Error((await answer.json().catch(() => ({}))).detail || answer.statusText);
      return answer;
    }
    async _json(path, body) { return (await this._post(path, body)).json(); }
    /** Curves of `traces` between two places on the axis: [{x, low, high}] of numbers, in the order of the traces; NaN
     * breaks a line. */
    async curves(request) {
      const bytes = await (await this._post("/data/curves", request)).arrayBuffer();
      const size = new DataView(bytes).getUint32(0, true);
      const head = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, size)));
      const array = ([first, count]) => new Float64Array(bytes, 4 + size + 8 * first, count);
      return head.map((curve) => Object.fromEntries(Object.entries(curve).map(([name, place]) => [name, array(place)])));
    }
    /** Two signals against each other: {t, x, y}. */
    pairs(request) { return this._json("/data/pairs", request); }
    /** All signals of a set at a time: {name: value}. */
    at(request) { return this._json("/data/at", request); }
  }

  /** What the views of one group share: cursor and window, in the unit of the axis. */
  class Link {
    constructor() { this.cursor = null; this.window = null; this.time = null; this.times = []; this.views = new Set(); }
    add(view) { this.views.add(view); }
    remove(view) { this.views.delete(view); }
    /** Put the cursor at a place of the axis. `times` are the times [s] there, one for each drive or lap that is shown:
     * [{set, time, color}]; without them the place is a time. */
    point(x, times) {
      this.times = times || [];
      this.cursor = x; this.time = this.times.length ? this.times[0].time : x;
      for (const view of this.views) if (view.onCursor) view.onCursor(x, this.time);
    }
    zoom(begin, end) {
      this.window = begin === null ? null : [begin, end];
      for (const view of this.views) if (view.onWindow) view.onWindow(this.window);
    }
  }

  const links = {};
  const colours = {
    ink: "#1b2430", muted: "#566170", grid: "#e6e9ed", frame: "#c3cad3", cursor: "#d1242f", reference: "#1b2430",
    estimate: "#0b63b6", band: "rgba(11,99,182,0.16)",
    wheels: { fl: "#0b63b6", fr: "#b4540a", rl: "#0a7a53", rr: "#8a3ea8" },
    series: ["#0b63b6", "#b4540a", "#0a7a53", "#8a3ea8", "#a8123e", "#4c5a00", "#006b7d", "#6b4a2b"],
  };

  /** Index of the value of an ascending array that is nearest to `x`. */
  function nearest(values, x) {
    let a = 0, b = values.length - 1;
    while (b - a > 1) { const m = (a + b) >> 1; if (values[m] <= x) a = m; else b = m; }
    return x - values[a] < values[b] - x ? a : b;
  }

  /** A canvas as large as its element, in device pixels; returns its context, scaled to CSS pixels. */
  function prepare(canvas, width, height) {
    const scale = window.devicePixelRatio || 1;
    const w = Math.max(1, Math.round(width * scale)), h = Math.max(1, Math.round(height * scale));
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const g = canvas.getContext("2d");
    g.setTransform(scale, 0, 0, scale, 0, 0);
    g.clearRect(0, 0, width, height);
    g.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    return g;
  }

  /** Round numbers between two limits, about `count` of them. */
  function ticks(low, high, count) {
    const span = high - low;
    if (!(span > 0) || !isFinite(span)) return [];
    const rough = span / Math.max(1, count), power = Math.pow(10, Math.floor(Math.log10(rough)));
    const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= rough * 0.999);
    const found = [];
    for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i++) found.push(+(i * step).toPrecision(12));
    return found;
  }

  /** A number as people read it. */
  function shown(value) {
    if (value === null || value === undefined || !isFinite(value)) return "–";
    const size = Math.abs(value);
    if (size === 0) return "0";
    if (size >= 1e6 || size < 1e-4) return value.toExponential(2);
    return size >= 1000 ? value.toFixed(0) : size >= 100 ? value.toFixed(1) : size >= 1 ? value.toFixed(2) : value.toPrecision(3);
  }

  const PLAYED = 10; // [s] that the curves show while the cursor runs
  let player = null;
  /** Let the cursor run through a drive of `duration` [s], `speed` times as fast as it was driven; 0 stops it. */
  function play(speed, duration) {
    cancelAnimationFrame(player);
    if (!speed) return;
    const link = links.main, begin = performance.now();
    const first = link.cursor === null || link.cursor >= duration - 0.1 ? 0 : link.cursor;
    const step = () => {
      const t = Math.min(duration, first + (speed * (performance.now() - begin)) / 1000);
      link.zoom(Math.max(0, t - PLAYED), Math.max(PLAYED, t));
      link.point(t);
      if (t < duration) player = requestAnimationFrame(step);
    };
    step();
  }

  /** Send the files of an input; the page then hears `vs_uploaded` with their paths and with sentences of refusal. */
  async function upload(input, files) {
    const paths = [], refused = [];
    for (const file of [...files]) {
      const answer = await fetch(`/data/uploads/${encodeURIComponent(file.name)}`, { method: "PUT", credentials: "same-origin", body: file })
        .catch(() => null);
      if (answer && answer.ok) { paths.push((await answer.json()).path); continue; }
      let words = answer ? await answer.text() : "The workbench does not answer; is the command still running?";
      try { words = JSON.parse(words).detail; } catch (error) { /* a sentence as it is */ }
      refused.push(`${file.name}: ${words}`);
    }
    input.value = "";
    emitEvent("vs_uploaded", { paths, refused });
  }

  Object.assign(window.VSense, {
    upload, play, source: new Server(), colours, nearest, prepare, ticks, shown,
    link: (group) => (links[group] = links[group] || new Link()),
    download(name, blob) {
      const a = document.createElement("a");
      a.href = URL.createObjectURL(blob); a.download = name; a.click();
      setTimeout(() => URL.revokeObjectURL(a.href), 1000);
    },
    make(kind, element, spec) { return new window.VSense[kind](element, spec); },
  });
})();
