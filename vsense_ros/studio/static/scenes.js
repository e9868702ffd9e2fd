// Map, g–g diagram and the car from above: they follow the cursor of the curves.
"use strict";
(() => {
  const V = window.VSense;

  /** A canvas that is drawn again when its size changes, and one above it for what follows the cursor. */
  class Scene {
    constructor(element, spec) {
      this.element = element;
      element.classList.add("vs-scene");
      this.canvas = element.appendChild(document.createElement("canvas"));
      this.canvas.setAttribute("role", "img");
      this.above = element.appendChild(document.createElement("canvas"));
      this.above.setAttribute("aria-hidden", "true");
      this.resized = new ResizeObserver(() => { if (this.element.clientWidth !== this.width) this.draw(); });
      this.resized.observe(element);
      this.update(spec);
    }
    update(spec) {
      if (this.link) this.link.remove(this);
      this.spec = spec;
      this.link = V.link(spec.group || "main");
      this.link.add(this);
      for (const canvas of [this.canvas, this.above]) canvas.style.height = `${spec.height || 260}px`;
      this.canvas.setAttribute("aria-label", spec.label || "");
      this.load();
    }
    dispose() { this.link.remove(this); this.resized.disconnect(); }
    begin(canvas) {
      this.width = this.element.clientWidth; this.height = this.spec.height || 260;
      return this.width ? V.prepare(canvas || this.canvas, this.width, this.height) : null;
    }
    onCursor() { if (!this.pending) { this.pending = true; requestAnimationFrame(() => { this.pending = false; this.follow(); }); } }
    /** Draw what is at the cursor. */
    follow() {}
    /** Times at the cursor of a set of curves, as [{time, color}]; without any, the one time of the cursor. */
    timesOf(set) {
      const own = this.link.times.filter((one) => one.set === set);
      if (own.length || this.link.time === null) return own;
      return this.link.times.length ? [] : [{ time: this.link.time }];
    }
    dot(g, x, y, colour) {
      g.fillStyle = colour || V.colours.cursor; g.strokeStyle = "#fff"; g.lineWidth = 1.5;
      g.beginPath(); g.arc(x, y, 5, 0, 7); g.fill(); g.stroke();
    }
    text(g, words, x, y, align) { g.textAlign = align || "left"; g.textBaseline = "middle"; g.fillText(words, x, y); }
  }

  /** The path of one or several drives, with the place of the cursor. spec: {paths: [{set, x, y, label, color}],
   *  marks: [{from, to}]}, the latter in [s] */
  class Path extends Scene {
    async load() {
      this.paths = [];
      try {
        this.paths = await Promise.all(this.spec.paths.map((p) => V.source.pairs({ set: p.set, x: p.x, y: p.y, most: 3000 })));
      } catch (error) { this.error = error.message; }
      this.draw();
      this.element.dataset.ready = "1";
    }
    draw() {
      const g = this.begin();
      if (!g) return;
      const C = V.colours, xs = this.paths.flatMap((p) => p.x), ys = this.paths.flatMap((p) => p.y);
      this.place = null;
      g.fillStyle = C.muted;
      if (!xs.length) { this.text(g, this.error || "no position in this recording", 12, 20); return; }
      const limits = (v) => v.reduce(([a, b], x) => (x === null ? [a, b] : [Math.min(a, x), Math.max(b, x)]), [Infinity, -Infinity]);
      const [x0, x1] = limits(xs), [y0, y1] = limits(ys), pad = 22;
      const scale = Math.min((this.width - 2 * pad) / Math.max(x1 - x0, 1), (this.height - 2 * pad) / Math.max(y1 - y0, 1));
      const px = (x) => this.width / 2 + (x - (x0 + x1) / 2) * scale, py = (y) => this.height / 2 - (y - (y0 + y1) / 2) * scale;
      this.paths.forEach((path, i) => {
        for (const mark of this.spec.marks || []) {
          const inside = [...path.x.keys()].filter((k) => path.t[k] >= mark.from && path.t[k] <= mark.to);
          g.strokeStyle = "rgba(209,36,47,0.35)"; g.lineWidth = 7; g.beginPath();
          inside.forEach((k, n) => (n ? g.lineTo(px(path.x[k]), py(path.y[k])) : g.moveTo(px(path.x[k]), py(path.y[k]))));
          g.stroke();
        }
        g.strokeStyle = this.spec.paths[i].color || C.series[i]; g.lineWidth = i ? 1.2 : 2; g.beginPath();
        path.x.forEach((x, k) => (k ? g.lineTo(px(x), py(path.y[k])) : g.moveTo(px(x), py(path.y[k]))));
        g.stroke();
      });
      const metres = V.ticks(0, (this.width / 3) / scale, 4).pop() || 1;
      g.strokeStyle = C.ink; g.lineWidth = 1.5; g.beginPath();
      g.moveTo(12, this.height - 10); g.lineTo(12 + metres * scale, this.height - 10); g.stroke();
      g.fillStyle = C.muted; this.text(g, `${metres} m`, 12, this.height - 20);
      this.text(g, "N ↑", this.width - 10, 14, "right");
      this.place = (path, k) => [px(path.x[k]), py(path.y[k])];
      this.follow();
    }
    follow() {
      const g = this.begin(this.above);
      if (!g || !this.place) return;
      this.paths.forEach((path, i) => {
        const times = this.timesOf(this.spec.paths[i].set);
        if (path.t.length) for (const { time, color } of times)
          this.dot(g, ...this.place(path, V.nearest(path.t, time)), this.link.times.length > 1 ? color : null);
      });
    }
  }

  /** Lateral against longitudinal acceleration. spec: {set, x, y} */
  class GG extends Scene {
    async load() {
      try { this.points = await V.source.pairs({ set: this.spec.set, x: this.spec.x, y: this.spec.y, most: 4000 }); } catch (error) { this.points = null; }
      this.draw();
      this.element.dataset.ready = "1";
    }
    draw() {
      const g = this.begin();
      if (!g || !this.points) return;
      const C = V.colours, p = this.points, middle = [this.width / 2, this.height / 2];
      const sorted = p.x.concat(p.y).filter((v) => v !== null).map(Math.abs).sort((a, b) => a - b);
      const most = Math.max(2, (sorted[Math.floor(sorted.length * 0.995)] || 1) * 1.15);
      const scale = (Math.min(this.width, this.height) / 2 - 16) / most;
      g.strokeStyle = C.grid; g.fillStyle = C.muted;
      for (const r of V.ticks(0, most, 3).filter((r) => r > 0)) {
        g.beginPath(); g.arc(...middle, r * scale, 0, 7); g.stroke();
        this.text(g, `${r}`, middle[0] + 3, middle[1] - r * scale + 7);
      }
      g.beginPath(); g.moveTo(middle[0], 8); g.lineTo(middle[0], this.height - 8); g.moveTo(8, middle[1]); g.lineTo(this.width - 8, middle[1]); g.stroke();
      // To the left of the picture is to the left of the car.
      const at = (k) => [middle[0] - p.x[k] * scale, middle[1] - p.y[k] * scale];
      g.fillStyle = "rgba(11,99,182,0.35)";
      for (let k = 0; k < p.t.length; k++) { const [x, y] = at(k); g.fillRect(x - 1, y - 1, 2, 2); }
      g.fillStyle = C.muted; this.text(g, "forward [m/s²]", middle[0] + 6, 12); this.text(g, "left", 6, middle[1] - 9);
      this.place = at;
      this.follow();
    }
    follow() {
      const g = this.begin(this.above), p = this.points;
      if (!g || !this.place || !p.t.length) return;
      for (const { time, color } of this.timesOf(this.spec.set))
        this.dot(g, ...this.place(V.nearest(p.t, time)), this.link.times.length > 1 ? color : null);
    }
  }

  /** The car from above with the force at each tyre. spec: {set, loads: {fl: N, …}, track, wheelbase} */
  class Car extends Scene {
    load() { this.values = {}; this.follow(); }
    async follow() {
      const t = this.link.time === null ? this.spec.time || 0 : this.link.time;
      if (this.asking) { this.again = true; return; }
      this.asking = true;
      try { this.values = await V.source.at({ set: this.spec.set, time: t }); } catch (error) { this.values = {}; }
      this.asking = false;
      this.draw();
      this.element.dataset.ready = "1";
      if (this.again) { this.again = false; this.follow(); }
    }
    draw() {
      const g = this.begin();
      if (!g) return;
      const C = V.colours, v = this.values, cx = this.width / 2, cy = this.height / 2 - 12;
      const length = this.height * 0.47, width = length * (this.spec.track || 1.55) / (this.spec.wheelbase || 2.7);
      g.strokeStyle = C.frame; g.lineWidth = 1.5;
      g.beginPath(); g.roundRect(cx - width * 0.5, cy - length * 0.68, width, length * 1.36, 16); g.stroke();
      g.fillStyle = C.muted; g.beginPath(); g.arc(cx, cy, 3, 0, 7); g.fill();
      const largest = Math.max(...Object.values(this.spec.loads || { fl: 4000 })), unit = (length * 0.24) / (largest / 1000);
      for (const wheel of ["fl", "fr", "rl", "rr"]) {
        const x = cx + (wheel[1] === "l" ? -1 : 1) * width * 0.5, y = cy + (wheel[0] === "f" ? -1 : 1) * length * 0.5;
        const [fx, fy, fz] = ["x", "y", "z"].map((a) => v[`wheel_force_${wheel}_${a}`]);
        const load = ((this.spec.loads || {})[wheel] || 4000) / 1000;
        const radius = isFinite(fz) && fz !== null ? Math.max(0, fz) * unit : load * unit;
        g.setLineDash([3, 3]); g.strokeStyle = C.muted; g.lineWidth = 1; g.beginPath(); g.arc(x, y, load * unit, 0, 7); g.stroke(); g.setLineDash([]);
        g.strokeStyle = C.wheels[wheel]; g.lineWidth = 1.5; g.beginPath(); g.arc(x, y, radius, 0, 7); g.stroke();
        g.fillStyle = "#39434f"; g.fillRect(x - 5, y - 13, 10, 26);
        if (fx === undefined || fx === null || fy === null) continue;
        const use = Math.hypot(fx, fy) / Math.max(fz, 0.05);
        const tx = x - fy * unit, ty = y - fx * unit, a = Math.atan2(ty - y, tx - x);
        g.strokeStyle = g.fillStyle = C.wheels[wheel]; g.lineWidth = 3; g.beginPath(); g.moveTo(x, y); g.lineTo(tx, ty); g.stroke();
        if (Math.hypot(tx - x, ty - y) > 6) { g.beginPath(); g.moveTo(tx + 7 * Math.cos(a), ty + 7 * Math.sin(a)); g.lineTo(tx + 4 * Math.cos(a + 2), ty + 4 * Math.sin(a + 2)); g.lineTo(tx + 4 * Math.cos(a - 2), ty + 4 * Math.sin(a - 2)); g.fill(); }
        const side = wheel[1] === "l" ? "left" : "right", edge = wheel[1] === "l" ? 8 : this.width - 8;
        g.fillStyle = C.ink;
        this.text(g, wheel.toUpperCase(), edge, y - 18, side);
        this.text(g, `Fz ${V.shown(fz)} kN`, edge, y - 3, side);
        this.text(g, `use ${(100 * use).toFixed(0)} %`, edge, y + 12, side);
      }
      g.fillStyle = C.muted; this.text(g, "circle: vertical force, dashed: at rest", cx, this.height - 22, "center");
      this.text(g, "arrow: force of the road on the tyre", cx, this.height - 8, "center");
    }
  }
  Object.assign(V, { Path, GG, Car });
})();
