'use strict';
// Sorts and filters the rows, and draws the small pictures of those that come into view.

const DATA = JSON.parse(document.getElementById('data').textContent);
const PANEL = {width: 96, height: 44, top: 13, side: 4};
const MORE = 50;            // rows that are laid out at once, as the page is scrolled
const body = document.querySelector('.rigs tbody');
const heads = [...document.querySelectorAll('.rigs th')];
// All rows, as they are sorted; those that match the filter; the first so many of these are shown.
const rows = [...body.rows, ...document.getElementById('rest').content.children];
let matching = rows, shown = body.rows.length;

function valueOf(row, column) {
  const cell = row.cells[column];
  return 'v' in cell.dataset ? Number(cell.dataset.v) : cell.textContent.trim();
}

function show() {
  const words = document.getElementById('filter').value.toLowerCase().split(/\s+/);
  matching = rows.filter(row => {
    const text = row.textContent.toLowerCase();
    return words.every(word => text.includes(word));
  });
  document.getElementById('shown').textContent = matching.length === rows.length ? '' :
    `${matching.length} of ${rows.length}`;
  shown = 0;
  body.replaceChildren();
  showMore();
}

function showMore(count = MORE) {
  const added = matching.slice(shown, shown + count);
  body.append(...added);
  shown += added.length;
  for (const row of added) watch.observe(row.querySelector('canvas'));
  if (added.length) {           // observed anew, it tells whether it is still in view
    ending.unobserve(END);
    ending.observe(END);
  }
}

function sortBy(column, way) {
  const keys = new Map(rows.map(row => [row, valueOf(row, column)]));
  const compare = (a, b) => typeof a === 'number' ? way * (a - b) :
    (a === '') - (b === '') || way * a.localeCompare(b, undefined, {numeric: true});
  rows.sort((a, b) => compare(keys.get(a), keys.get(b)));
  heads.forEach((head, k) => k === column ?
    head.setAttribute('aria-sort', way > 0 ? 'ascending' : 'descending') :
    head.removeAttribute('aria-sort'));
  show();
}

heads.forEach((head, column) => head.querySelector('button')?.addEventListener('click', () => {
  const number = 'v' in (rows[0]?.cells[column].dataset ?? {});
  const now = head.getAttribute('aria-sort');
  sortBy(column, now === 'descending' ? 1 : now === 'ascending' ? -1 : number ? -1 : 1);
}));

document.getElementById('filter').addEventListener('input', show);
addEventListener('beforeprint', () => showMore(Infinity));

// One scale for all rigs of a group: over time, and over each parameter.
const scaled = (value, log) => log ? Math.log(value) : value;
for (const panels of Object.values(DATA.groups)) {
  for (const panel of panels) Object.assign(panel, {low: Infinity, high: -Infinity});
}
let begin = Infinity, end = -Infinity;
for (const rig of DATA.rigs) {
  rig.points.forEach((points, k) => {
    const panel = DATA.groups[rig.group][k];
    for (const point of points) {
      point[0] = Date.parse(point[0]);
      if (Number.isFinite(point[0])) {
        begin = Math.min(begin, point[0]);
        end = Math.max(end, point[0]);
      }
      if (panel.log && point[1] <= 0) continue;
      const value = scaled(point[1], panel.log);
      panel.low = Math.min(panel.low, value);
      panel.high = Math.max(panel.high, value);
    }
  });
}

function draw(canvas, rig) {
  const panels = DATA.groups[rig.group];
  const ratio = window.devicePixelRatio || 1;
  canvas.width = canvas.clientWidth * ratio;
  canvas.height = PANEL.height * ratio;
  const context = canvas.getContext('2d');
  context.scale(ratio, ratio);
  context.font = '9px system-ui, sans-serif';
  panels.forEach((panel, k) => {
    const left = k * PANEL.width + PANEL.side, right = (k + 1) * PANEL.width - 2 * PANEL.side;
    const bottom = PANEL.height - 2;
    const room = 0.08 * (panel.high - panel.low) || 0.5;
    const low = panel.low - room, high = panel.high + room;
    const x = time => end > begin && Number.isFinite(time) ?
      left + 2 + (right - left - 4) * (time - begin) / (end - begin) : (left + right) / 2;
    const y = value => bottom + (PANEL.top - bottom) * (value - low) / (high - low);
    const inside = value => Math.min(bottom, Math.max(PANEL.top, value));
    const mean = scaled(panel.mean, panel.log);
    const from = inside(y(mean + 2 * panel.spread)), to = inside(y(mean - 2 * panel.spread));
    context.fillStyle = '#f6f6f6';
    context.fillRect(left, PANEL.top, right - left, bottom - PANEL.top);
    context.fillStyle = '#dde6dd';
    context.fillRect(left, from, right - left, Math.max(1, to - from));
    context.fillStyle = '#666';
    context.fillText(panel.name.replace(/ at .*: /, ' '), left, PANEL.top - 4, right - left);
    const points = rig.points[k].filter(([, value]) => !panel.log || value > 0);
    const colour = rig.out[k] ? '#b2182b' : '#1b6e4a';
    context.fillStyle = context.strokeStyle = colour;
    context.beginPath();
    points.forEach(([time, value], n) =>
      context[n ? 'lineTo' : 'moveTo'](x(time), y(scaled(value, panel.log))));
    context.stroke();
    for (const [time, value, error] of points) {
      const at = scaled(value, panel.log), spread = panel.log ? error / value : error;
      context.fillRect(x(time) - 1.5, y(at) - 1.5, 3, 3);
      const high = inside(y(at + spread));
      context.fillRect(x(time) - 0.5, high, 1, inside(y(at - spread)) - high);
    }
  });
}

const watch = new IntersectionObserver(entries => {
  for (const entry of entries) {
    if (!entry.isIntersecting) continue;
    watch.unobserve(entry.target);
    draw(entry.target, DATA.rigs[entry.target.closest('tr').dataset.k]);
  }
}, {rootMargin: '300px'});
for (const row of body.rows) watch.observe(row.querySelector('canvas'));

const END = document.getElementById('end');
const ending = new IntersectionObserver(entries => {
  if (entries.some(entry => entry.isIntersecting)) showMore();
}, {rootMargin: '600px'});
ending.observe(END);
