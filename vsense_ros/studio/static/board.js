// Plots above one another with one axis: linked cursor and zoom, levels of detail, values at the cursor.
"use strict";
(() => {
  const V = window.VSense;
  const LEFT = 58, RIGHT = 8, TOP = 6, AXIS = 20; // [px] around the lines
  const make = (tag, className, parent, text) => {
    const element = document.createElement(tag);
    if (className) element.className = className;
    if (text !== undefined) element.textContent = text;
    if (parent) parent.appendChild(element);
    return element;
  };

  class Board {
    /** spec: {group, axis, xlabel, end, plots: [{title, unit, height, traces: [{set, name, label, color, dash, band:
     * [low, high], shift, begin, end}]}], marks: [{from, to, label}]} */
    constructor(element, spec) {
      this.element = element;
      element.classList.add("vs-board");
      element.tabIndex = 0;
      element.setAttribute("role", "group");
      element.setAttribute("aria-label", "Curves. Arrow keys move the cursor, plus and minus zoom, Home shows all.");
      this.resized = new ResizeObserver(() => { if (this.element.clientWidth !== this.width) this.layout(); });
      this.resized.observe(element);
      element.addEventListener("keydown", (event) => this.onKey(event));
      this.update(spec);
    }
    update(spec) {
      if (this.link) this.link.remove(this);
      this.spec = spec;
      this.link = V.link(spec.group || "main");
      this.link.add(this);
      this.full = [0, spec.end || 1];
      this.axis = spec.axis;
      if (this.link.axis !== spec.axis) Object.assign(this.link, { axis: spec.axis, window: null, cursor: null });
      const kept = this.link.window; // of a board before this one: its part of the drive is shown again
      this.window = kept && kept[1] <= this.full[1] && !this.link.whole ? kept.slice() : this.full.slice();
      this.build();
    }
    dispose() { this.link.remove(this); this.resized.disconnect(); this.release(); }
    /** Give back the memory of the pictures, which would stay until the browser looks for what is not used any more. */
    release() { for (const { canvas } of this.plots || []) canvas.width = canvas.height = 0; }

    build() {
      this.release();
      this.element.replaceChildren();
      this.plots = this.spec.plots.map((plot) => {
        const box = make("div", "vs-plot", this.element);
        const head = make("div", "vs-plot-head", box);
        make("span", "vs-plot-title", head, plot.title);
        make("span", "vs-plot-unit", head, plot.unit ? `[${plot.unit}]` : "");
        const legend = make("span", "vs-legend", head);
        const values = plot.traces.map((trace) => {
          const entry = make("span", "vs-legend-entry", legend);
          const key = make("i", "", entry);
          key.style.background = trace.dash ? `repeating-linear-gradient(90deg, ${trace.color} 0 4px, transparent 4px 7px)` : trace.color;
          make("span", "", entry, trace.label);
          return make("b", "", entry, "");
        });
        const tools = make("span", "vs-tools", head);
        const canvas = make("canvas", "", box);
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", `${plot.title}${plot.unit ? " in " + plot.unit : ""}: ${plot.traces.map((t) => t.label).join(", ")}`);
        const made = { plot, canvas, values, curves: [], height: plot.height || 120 };
        for (const [label, title, action] of [
          ["CSV", `Copy ${plot.title} as CSV`, () => this.copyCsv(made)],
          ["PNG", `Save ${plot.title} as PNG`, () => canvas.toBlob((blob) => V.download(`${plot.title}.png`, blob))],
        ]) {
          const button = make("button", "vs-tool", tools, label);
          button.type = "button"; button.title = title; button.setAttribute("aria-label", title);
          button.addEventListener("click", action);
        }
        this.listen(canvas);
        return made;
      });
      this.cursorLine = make("div", "vs-cursor", this.element);
      this.layout();
    }
    layout() {
      this.width = this.element.clientWidth;
      this.plots.forEach((made, i) => {
        made.full = made.height + (i === this.plots.length - 1 ? AXIS : 0);
        made.canvas.style.height = `${made.full}px`;
      });
      this.draw();
      this.ask();
    }
    x(value) { return LEFT + ((value - this.window[0]) / (this.window[1] - this.window[0])) * (this.width - LEFT - RIGHT); }
    place(pixel) { return this.window[0] + ((pixel - LEFT) / Math.max(1, this.width - LEFT - RIGHT)) * (this.window[1] - this.window[0]); }

    /** Ask for the curves of the window: at once, or, while an answer is awaited, after it. */
    ask() { if (this.asking && this.asked === this.spec) this.again = true; else this.load(); }
    async load() {
      if (!this.width) return;
      const width = this.width, began = performance.now(), serial = (this.serial = (this.serial || 0) + 1);
      const traces = [], cut = (t) => ({ set: t.set, begin: t.begin, end: t.end });
      for (const { plot } of this.plots) for (const t of plot.traces) {
        traces.push({ ...cut(t), name: t.name, minus: t.minus ? { ...cut(t.minus), name: t.minus.name } : undefined });
        for (const name of t.band || []) traces.push({ ...cut(t), name });
      }
      const bins = Math.max(100, Math.min(1000, Math.round((this.width - LEFT - RIGHT) * 0.6)));
      let found;
      this.asking = true; this.asked = this.spec;
      try {
        found = await V.source.curves({ axis: this.axis || "time", begin: this.window[0], end: this.window[1], bins, traces });
      } catch (error) { if (serial === this.serial) this.fail(error.message); return; } finally { if (serial === this.serial) this.asking = false; }
      if (serial !== this.serial) return;
      let k = 0;
      for (const made of this.plots) {
        made.curves = made.plot.traces.map((t) => {
          const curve = found[k++];
          if (t.band) curve.band = [found[k++], found[k++]];
          return curve;
        });
        made.range = this.rangeOf(made);
      }
      this.draw();
      this.element.dataset.ms = (performance.now() - began).toFixed(1);
      this.element.dataset.ready = String(serial);
      if (this.again || this.width !== width) { this.again = false; this.load(); }
    }
    fail(sentence) {
      this.element.replaceChildren();
      make("p", "vs-error", this.element, sentence).setAttribute("role", "alert");
    }

    draw() { for (let i = 0; i < this.plots.length; i++) this.drawPlot(this.plots[i], i === this.plots.length - 1); this.showCursor(); }
    drawPlot(made, last) {
      const { canvas, height } = made, width = this.width, C = V.colours;
      if (!width) return;
      const g = V.prepare(canvas, width, made.full);
      const [low, high] = made.range || [-1, 1];
      const y = (v) => TOP + (1 - (v - low) / (high - low)) * (height - TOP - 4);
      g.lineWidth = 1; g.strokeStyle = C.grid; g.fillStyle = C.muted; g.textBaseline = "middle"; g.textAlign = "right";
      for (const v of V.ticks(low, high, Math.max(3, height / 28))) {
        const at = Math.round(y(v)) + 0.5;
        g.beginPath(); g.moveTo(LEFT, at); g.lineTo(width - RIGHT, at); g.stroke();
        g.fillText(String(v).replace("-", "−"), LEFT - 6, at);
      }
      g.textAlign = "center"; g.textBaseline = "top";
      for (const v of V.ticks(...this.window, width / 110)) {
        const at = Math.round(this.x(v)) + 0.5;
        g.beginPath(); g.moveTo(at, TOP); g.lineTo(at, height - 4); g.stroke();
        if (last && at < width - RIGHT - 76) g.fillText(String(v).replace("-", "−"), at, height + 1);
      }
      if (last) { g.textAlign = "right"; g.fillText(this.spec.xlabel || "time [s]", width - RIGHT, height + 1); }
      g.save();
      g.beginPath(); g.rect(LEFT, TOP, width - LEFT - RIGHT, height - TOP - 4); g.clip();
      for (const mark of this.spec.marks || []) {
        const a = this.x(mark.from), b = Math.max(a + 2, this.x(mark.to));
        g.fillStyle = "rgba(209,36,47,0.10)"; g.fillRect(a, TOP, b - a, height);
      }
      made.plot.traces.forEach((trace, i) => {
        const curve = made.curves[i];
        if (!curve) return;
        if (curve.band) this.fill(g, curve.band[0], curve.band[1], y, trace.fill || C.band);
        this.line(g, curve, y, trace.color, trace.dash, trace.width || 1.3);
      });
      g.restore();
      g.strokeStyle = C.frame; g.strokeRect(LEFT + 0.5, TOP + 0.5, width - LEFT - RIGHT - 1, height - TOP - 5);
      if (this.drag && !this.drag.pan) {
        const a = this.drag.from, b = this.drag.to;
        g.fillStyle = "rgba(11,99,182,0.12)"; g.fillRect(Math.min(a, b), TOP, Math.abs(b - a), height - TOP - 4);
      }
    }
    line(g, curve, y, colour, dash, width) {
      const { x, low, high } = curve, [first, last] = this.window, scale = (this.width - LEFT - RIGHT) / (last - first);
      const fine = x.length > this.width / 4; // a line of one pixel of the screen is drawn many times faster than a wider one
      g.strokeStyle = colour; g.lineWidth = fine ? 1 / (window.devicePixelRatio || 1) : width;
      g.setLineDash(dash ? [5, 4] : []); g.lineJoin = "bevel";
      g.beginPath();
      let pen = false, before = 0;
      for (let i = 0; i < x.length; i++) {
        let a = low[i], b = high[i];
        if (a !== a || b !== b) { pen = false; continue; }
        if (pen && before - a > b - before) [a, b] = [b, a]; // a falling line goes through the larger value first
        before = b;
        const at = LEFT + (x[i] - first) * scale;
        if (pen) g.lineTo(at, y(a)); else g.moveTo(at, y(a));
        if (b !== a) g.lineTo(at, y(b));
        else if (!pen && (i + 1 === x.length || low[i + 1] !== low[i + 1])) g.lineTo(at + 1, y(a));
        pen = true;
      }
      g.stroke(); g.setLineDash([]);
    }
    fill(g, low, high, y, colour) {
      g.fillStyle = colour;
      const n = Math.min(low.x.length, high.x.length), absent = (i) => low.low[i] !== low.low[i] || high.high[i] !== high.high[i];
      for (let i = 0; i < n; ) {
        while (i < n && absent(i)) i++;
        let j = i;
        while (j < n && !absent(j)) j++;
        if (j > i + 1) {
          g.beginPath();
          for (let k = i; k < j; k++) g.lineTo(this.x(high.x[k]), y(high.high[k]));
          for (let k = j - 1; k >= i; k--) g.lineTo(this.x(low.x[k]), y(low.low[k]));
          g.fill();
        }
        i = j + 1;
      }
    }
    /** Limits that show the curves after start-up: lonely extremes do not flatten the rest, nor does a wide band. */
    rangeOf(made) {
      let count = 0;
      const values = new Float64Array(made.curves.reduce((sum, curve) => sum + 2 * curve.x.length, 0));
      for (const curve of made.curves) for (let i = 0; i < curve.x.length; i++) {
        if (curve.x[i] < this.window[0] || curve.x[i] > this.window[1] || curve.low[i] !== curve.low[i]) continue;
        values[count++] = curve.low[i]; values[count++] = curve.high[i];
      }
      if (!count) return [-1, 1];
      const sorted = values.subarray(0, count).sort();
      const at = (share) => sorted[Math.min(count - 1, Math.floor(share * count))];
      let low = sorted[0], high = sorted[count - 1];
      const inner = at(0.995) - at(0.005);
      if (inner > 0 && inner < 0.4 * (high - low)) { low = at(0.005) - 0.25 * inner; high = at(0.995) + 0.25 * inner; }
      const least = Math.max(Math.abs(low), Math.abs(high)) * 1e-6 || 1e-9;
      const pad = Math.max(0.06 * (high - low), least);
      return [low - pad, high + pad];
    }
    /** The cursor is an element of its own above the plots, so that it moves without drawing a curve anew. */
    showCursor() {
      const x = this.link.cursor, at = x === null ? -1 : Math.round(this.x(x));
      this.cursorLine.hidden = !(at >= LEFT && at <= this.width - RIGHT);
      this.cursorLine.style.transform = `translateX(${at}px)`;
      for (const made of this.plots) made.values.forEach((target, i) => {
        const curve = made.curves[i];
        let text = "";
        if (x !== null && curve && curve.x.length) {
          const k = V.nearest(curve.x, x);
          text = V.shown((curve.low[k] + curve.high[k]) / 2);
        }
        if (target.firstChild) target.firstChild.data = text; else target.textContent = text;
      });
    }

    listen(canvas) {
      const pixel = (event) => event.clientX - canvas.getBoundingClientRect().left;
      canvas.addEventListener("pointermove", (event) => {
        const at = pixel(event);
        if (this.drag) { this.moveDrag(at); return; }
        if (event.pointerType === "mouse") this.point(this.place(at));
      });
      canvas.addEventListener("pointerdown", (event) => {
        if (event.button) return;
        const at = pixel(event);
        this.drag = { from: at, to: at, pan: event.shiftKey, window: this.window.slice() };
        canvas.setPointerCapture(event.pointerId);
        this.element.focus({ preventScroll: true });
      });
      canvas.addEventListener("pointerup", () => this.endDrag());
      canvas.addEventListener("pointercancel", () => { this.drag = null; this.draw(); });
      canvas.addEventListener("dblclick", () => this.zoom(...this.full));
      canvas.addEventListener("wheel", (event) => {
        if (!event.ctrlKey) return;
        event.preventDefault();
        this.zoomAbout(this.place(pixel(event)), event.deltaY > 0 ? 1.25 : 0.8);
      }, { passive: false });
    }
    moveDrag(at) {
      this.drag.to = at;
      if (this.drag.pan) {
        const [a, b] = this.drag.window, d = ((this.drag.from - at) / (this.width - LEFT - RIGHT)) * (b - a);
        this.zoom(a + d, b + d);
      } else this.draw();
    }
    endDrag() {
      const drag = this.drag;
      this.drag = null;
      if (!drag || drag.pan) return;
      if (Math.abs(drag.to - drag.from) > 5) this.zoom(...[this.place(drag.from), this.place(drag.to)].sort((a, b) => a - b));
      else { this.point(this.place(drag.to)); this.draw(); }
    }
    point(x) {
      const at = Math.min(this.full[1], Math.max(this.full[0], x));
      this.link.point(at, this.timesAt(at));
    }
    /** Times [s] at a place of the axis in each drive or lap that is shown. */
    timesAt(x) {
      const seen = new Set(), found = [];
      for (const made of this.plots) made.plot.traces.forEach((trace, i) => {
        const part = `${trace.set} ${trace.begin}`, curve = made.curves[i];
        if (seen.has(part) || !curve || !curve.x.length || (this.axis === "distance" && !curve.t)) return;
        seen.add(part);
        if (x > curve.x[curve.x.length - 1] && trace.end) return;
        found.push({ set: trace.set, color: trace.color, time: this.axis === "distance" ? between(curve.x, curve.t, x) : x + (trace.begin || 0) });
      });
      return found;
    }
    onCursor() { if (!this.pending) { this.pending = true; requestAnimationFrame(() => { this.pending = false; this.showCursor(); }); } }
    onWindow(window) { this.window = (window || this.full).slice(); this.draw(); this.ask(); }
    zoom(begin, end) {
      const width = Math.max(end - begin, (this.full[1] - this.full[0]) * 1e-6);
      begin = Math.max(this.full[0], Math.min(begin, this.full[1] - width));
      this.link.whole = width >= this.full[1] - this.full[0];
      this.link.zoom(begin, Math.min(this.full[1], begin + width));
    }
    zoomAbout(x, factor) { this.zoom(x - (x - this.window[0]) * factor, x + (this.window[1] - x) * factor); }
    onKey(event) {
      if (event.target !== this.element) return;
      const [a, b] = this.window, step = (b - a) / (event.ctrlKey ? 20 : 400);
      const cursor = this.link.cursor === null ? (a + b) / 2 : this.link.cursor;
      const keys = {
        ArrowLeft: () => (event.shiftKey ? this.zoom(a - 0.1 * (b - a), b - 0.1 * (b - a)) : this.point(cursor - step)),
        ArrowRight: () => (event.shiftKey ? this.zoom(a + 0.1 * (b - a), b + 0.1 * (b - a)) : this.point(cursor + step)),
        "+": () => this.zoomAbout(cursor, 0.5), "=": () => this.zoomAbout(cursor, 0.5), "-": () => this.zoomAbout(cursor, 2),
        Home: () => this.zoom(...this.full), 0: () => this.zoom(...this.full),
      };
      if (!keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    }
    copyCsv(made) {
      const traces = made.plot.traces, unit = made.plot.unit ? ` [${made.plot.unit}]` : "";
      const rows = [[this.spec.xlabel || "time [s]", ...traces.map((t) => `${t.label}${unit}`)].map((h) => `"${h}"`).join(",")];
      const first = made.curves[0] || { x: [] };
      for (let i = 0; i < first.x.length; i++) {
        const at = first.x[i];
        rows.push([at, ...made.curves.map((c) => this.valueAt(c, at))].join(","));
      }
      const text = rows.join("\n") + "\n";
      (navigator.clipboard ? navigator.clipboard.writeText(text) : Promise.reject()).catch(() =>
        V.download(`${made.plot.title}.csv`, new Blob([text], { type: "text/csv" })));
      window.dispatchEvent(new CustomEvent("vs-copied", { detail: `${made.plot.title} copied as CSV` }));
    }
    valueAt(curve, x) {
      if (!curve || !curve.x.length) return "";
      const k = V.nearest(curve.x, x), value = (curve.low[k] + curve.high[k]) / 2;
      return value === value ? value : "";
    }
  }

  /** Value of an array at `x` by interpolation over another, ascending one. */
  const between = (xs, values, x) => {
    let a = 0, b = xs.length - 1;
    while (b - a > 1) { const m = (a + b) >> 1; if (xs[m] <= x) a = m; else b = m; }
    const share = xs[b] > xs[a] ? Math.min(1, Math.max(0, (x - xs[a]) / (xs[b] - xs[a]))) : 0;
    return values[a] + share * (values[b] - values[a]);
  };
  V.Board = Board;
})();
