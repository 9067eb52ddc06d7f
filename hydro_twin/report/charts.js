'use strict';
// Charts that are zoomed along x: drag, or the keys + - and arrows; a double click, the key 0 or
// the button shows the whole range again. The charts of one view move together.

const MARGIN = {left: 62, right: 14, top: 8, bottom: 42};
const HEIGHT = 260;
const FONT = '12px system-ui, sans-serif';

const place = (curve, k) => Array.isArray(curve.x) ? curve.x[k] : curve.x.start + k * curve.x.step;

function element(tag, parent, properties = {}) {
  return parent.appendChild(Object.assign(document.createElement(tag), properties));
}

function written(value) {
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e5 || size < 1e-3)) {
    return value.toExponential(3).replace(/\.?0+e/, 'e').replace('e+', 'e');
  }
  return String(Number(value.toPrecision(4)));
}

function ticks(low, high, most, log) {
  if (log && high / low > 10) {
    const found = [];
    for (let e = Math.ceil(Math.log10(low)); 10 ** e <= high; e++) found.push(10 ** e);
    return found;
  }
  const rough = (high - low) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find(factor => factor * power >= rough);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
  return found;
}

class Chart {
  constructor(parent, chart, view) {
    Object.assign(this, chart);
    this.view = view;
    this.hidden = new Set();
    this.legend = element('div', parent, {className: 'legend'});
    this.canvas = element('canvas', parent, {tabIndex: 0});
    this.canvas.setAttribute('role', 'img');
    this.canvas.setAttribute('aria-label', `Chart of ${this.yLabel} over ${this.xLabel}: ` +
      `${this.curves.map(curve => curve.label).join(', ')}. Arrows, plus and minus zoom, 0 resets.`);
    this.canvas.style.height = `${HEIGHT * this.height}px`;
    for (const curve of this.curves) this.key(curve);
    this.listen();
  }

  key(curve) {
    const key = element('button', this.legend, {type: 'button', textContent: curve.label});
    key.setAttribute('aria-pressed', 'true');
    key.style.setProperty('--colour', curve.colour);
    key.addEventListener('click', () => {
      if (!this.hidden.delete(curve)) this.hidden.add(curve);
      key.setAttribute('aria-pressed', String(!this.hidden.has(curve)));
      this.draw();
    });
  }

  to(x) { return this.log ? Math.log10(x) : x; }
  from(x) { return this.log ? 10 ** x : x; }

  reach() {                                 // of all x, on the scale of the axis
    let low = Infinity, high = -Infinity;
    for (const curve of this.curves) {
      for (let k = 0; k < curve.y.length; k++) {
        const x = this.to(place(curve, k));
        low = Math.min(low, x);
        high = Math.max(high, x);
      }
    }
    const room = 0.01 * (high - low || 1);
    return [low - room, high + room];
  }

  span() {                                  // of the y within the range shown
    let low = Infinity, high = -Infinity;
    for (const curve of this.curves) {
      if (this.hidden.has(curve)) continue;
      for (let k = 0; k < curve.y.length; k++) {
        const x = this.to(place(curve, k)), y = curve.y[k];
        if (y === null || x < this.range[0] || x > this.range[1] || this.log && y <= 0) continue;
        const bar = curve.error ? curve.error[k] : 0;
        low = Math.min(low, this.to(y - bar));
        high = Math.max(high, this.to(y + bar));
      }
    }
    if (low > high) return [0, 1];
    const room = 0.06 * (high - low) || 0.1 * Math.abs(high) || 1;
    return [low - room, high + room];
  }

  draw() {
    const width = this.canvas.clientWidth, height = HEIGHT * this.height;
    if (!width) return;
    const scale = Math.max(2, window.devicePixelRatio);    // sharp in print, too
    this.canvas.width = width * scale;
    this.canvas.height = height * scale;
    const c = this.context = this.canvas.getContext('2d');
    c.scale(scale, scale);
    c.font = FONT;
    this.range = this.view.range || this.view.reach;
    const [bottom, top] = this.span();
    const w = width - MARGIN.left - MARGIN.right, h = height - MARGIN.top - MARGIN.bottom;
    this.box = {w, h};
    this.px = x => MARGIN.left + w * (this.to(x) - this.range[0]) / (this.range[1] - this.range[0]);
    this.py = y => MARGIN.top + h * (top - this.to(y)) / (top - bottom);
    this.axes(width, height, bottom, top);
    c.save();
    c.beginPath();
    c.rect(MARGIN.left, MARGIN.top, w, h);
    c.clip();
    for (const curve of this.curves) if (!this.hidden.has(curve)) this.curve(curve);
    if (this.drag) {
      c.fillStyle = 'rgba(70, 110, 180, 0.2)';
      c.fillRect(this.drag[0], MARGIN.top, this.drag[1] - this.drag[0], h);
    }
    c.restore();
  }

  axes(width, height, bottom, top) {
    const c = this.context, {w, h} = this.box;
    c.strokeStyle = '#dddddd';
    c.fillStyle = '#333333';
    c.textAlign = 'center';
    for (const x of ticks(this.from(this.range[0]), this.from(this.range[1]), w / 60, this.log)) {
      this.rule(this.px(x), MARGIN.top, this.px(x), MARGIN.top + h);
      c.fillText(written(x), this.px(x), MARGIN.top + h + 16);
    }
    c.textAlign = 'right';
    for (const y of ticks(this.from(bottom), this.from(top), Math.max(4, h / 32), this.log)) {
      this.rule(MARGIN.left, this.py(y), MARGIN.left + w, this.py(y));
      c.fillText(written(y), MARGIN.left - 6, this.py(y) + 4);
    }
    c.strokeStyle = '#888888';
    c.strokeRect(MARGIN.left, MARGIN.top, w, h);
    c.textAlign = 'center';
    c.fillText(this.xLabel, MARGIN.left + w / 2, height - 6);
    c.save();
    c.translate(12, MARGIN.top + h / 2);
    c.rotate(-Math.PI / 2);
    c.fillText(this.yLabel, 0, 0, height);
    c.restore();
  }

  rule(x0, y0, x1, y1) {
    this.context.beginPath();
    this.context.moveTo(x0, y0);
    this.context.lineTo(x1, y1);
    this.context.stroke();
  }

  curve(curve) {
    const c = this.context;
    c.strokeStyle = c.fillStyle = curve.colour;
    c.lineWidth = curve.kind === 'thick' ? 3.5 : 1.4;
    c.setLineDash(curve.kind === 'dash' ? [5, 4] : []);
    const marks = {dots: 1.3, points: 4}[curve.kind];
    let pen = false;
    c.beginPath();
    for (let k = 0; k < curve.y.length; k++) {
      const x = this.px(place(curve, k)), value = curve.y[k];
      if (value === null) { pen = false; continue; }
      const y = this.py(value);
      if (marks) {
        c.moveTo(x + marks, y);
        c.arc(x, y, marks, 0, 2 * Math.PI);
        if (curve.error) {
          this.rule(x, this.py(value - curve.error[k]), x, this.py(value + curve.error[k]));
          c.beginPath();
          c.arc(x, y, marks, 0, 2 * Math.PI);
          c.fill();
          c.beginPath();
        }
      } else if (pen) c.lineTo(x, y);
      else c.moveTo(x, y);
      pen = true;
    }
    if (marks) c.fill(); else c.stroke();
    c.setLineDash([]);
    c.lineWidth = 1;
  }

  listen() {
    const inside = event => event.clientX - this.canvas.getBoundingClientRect().left;
    const unit = pixel => this.range[0] +
      (pixel - MARGIN.left) / this.box.w * (this.range[1] - this.range[0]);
    this.canvas.addEventListener('pointerdown', event => {
      if (event.button === 0) this.drag = [inside(event), inside(event)];
    });
    this.canvas.addEventListener('pointermove', event => {
      this.view.read(unit(inside(event)));
      if (!this.drag) return;
      this.drag[1] = inside(event);
      this.draw();
    });
    const end = () => {                     // leaving the chart ends a drag at its edge
      if (!this.drag) return;
      const [a, b] = this.drag.map(unit).sort((p, q) => p - q);
      const wide = Math.abs(this.drag[1] - this.drag[0]) > 5;
      this.drag = null;
      this.view.zoom(wide ? [a, b] : this.view.range);
    };
    this.canvas.addEventListener('pointerup', end);
    this.canvas.addEventListener('pointerleave', end);
    this.canvas.addEventListener('pointercancel', () => {   // the finger scrolls the page instead
      this.drag = null;
      this.draw();
    });
    this.canvas.addEventListener('dblclick', () => this.view.zoom(null));
    this.canvas.addEventListener('keydown', event => {
      const [a, b] = this.range, size = b - a;
      const moved = {'+': [a + size / 4, b - size / 4], '=': [a + size / 4, b - size / 4],
                     '-': [a - size / 2, b + size / 2],
                     'ArrowLeft': [a - size / 5, b - size / 5],
                     'ArrowRight': [a + size / 5, b + size / 5]}[event.key];
      if (moved) this.view.zoom(moved);
      else if (event.key === '0' || event.key === 'Escape') this.view.zoom(null);
      else return;
      event.preventDefault();
    });
  }
}

class View {
  constructor(parent, view) {
    this.box = element('div', parent, {className: 'view'});
    this.range = null;
    this.charts = view.charts.map(chart => new Chart(this.box, chart, this));
    const reaches = this.charts.map(chart => chart.reach());
    this.reach = [Math.min(...reaches.map(r => r[0])), Math.max(...reaches.map(r => r[1]))];
    const bar = element('p', this.box, {className: 'bar'});
    this.whole = element('button', bar, {type: 'button', textContent: 'whole range', hidden: true});
    this.whole.addEventListener('click', () => this.zoom(null));
    this.reading = element('output', bar);
    new ResizeObserver(() => this.draw()).observe(this.box);
  }

  draw() { for (const chart of this.charts) chart.draw(); }

  zoom(range) {                             // kept within what there is
    const [low, high] = this.reach;
    const within = range && [Math.max(range[0], low), Math.min(range[1], high)];
    this.range = within && within[1] - within[0] < 0.999 * (high - low) &&
      within[1] - within[0] > 1e-6 * (high - low) ? within : null;
    this.whole.hidden = !this.range;
    this.draw();
  }

  read(x) {                                 // values of the first chart's lines nearest to x
    const chart = this.charts[0], texts = [];
    for (const curve of chart.curves) {
      if (Array.isArray(curve.x) || chart.hidden.has(curve)) continue;
      const k = Math.round((chart.from(x) - curve.x.start) / curve.x.step);
      const y = curve.y[k];
      if (y !== null && y !== undefined) texts.push(`${curve.label} ${written(y)}`);
    }
    this.reading.textContent = texts.length ? `${written(chart.from(x))}: ${texts.join(', ')}` : '';
  }
}

function illustrate(parent, illustration) {
  const views = illustration.views;
  const holder = element('div', parent);
  const show = k => { holder.replaceChildren(); new View(holder, views[k]).draw(); };
  if (views.length > 1) {
    const label = document.createElement('label');
    parent.insertBefore(label, holder).textContent = 'Part: ';
    const choice = element('select', label);
    views.forEach((view, k) => element('option', choice, {value: k, textContent: view.label}));
    choice.addEventListener('change', () => show(Number(choice.value)));
  }
  show(0);
}

const data = JSON.parse(document.getElementById('data').textContent);
for (const [name, illustration] of Object.entries(data)) {
  illustrate(document.getElementById(name), illustration);
}
