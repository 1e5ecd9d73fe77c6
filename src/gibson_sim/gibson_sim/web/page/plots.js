// Plots of numeric fields of topics over the last minute.
import { $, element, note, remember, remembered } from './dom.js';

const SPAN = 60; // seconds
const MAX_CURVES = 16, MAX_IN_ONE = 4;
const COLORS = ['--accent', '--curve-2', '--curve-3', '--curve-4'], DASHES = [[], [7, 3], [2, 3], [9, 3, 2, 3]]; // told apart without colours, too

// Returns ticks at round numbers, at intervals of a quarter of the range or more.
export function ticks(low, high) {
  const rough = (high - low) / 4, power = 10 ** Math.floor(Math.log10(rough)), step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= rough);
  const first = Math.ceil(low / step), values = [];
  for (let k = first; k * step <= high + step * 1e-9; k++) values.push(k * step);
  return values;
}

// Default field of a message: patterns in order of preference; times last.
const USEFUL = [/^twist\.twist\.linear\.x$/, /(^|\.)linear\.x$/, /(^|\.)position\.x$/, /^ranges\[/, /^(velocity|position)\[/, /^data$/, /^percentage$/, /linear_acceleration\.x$/, /translation\.x$/];
const TIME = /(^|\.)(header|stamp|clock)\.|(^|\.)(sec|nanosec|covariance\[\d+\])$/;
export function useful(paths) {
  for (const pattern of USEFUL) { const match = paths.find((path) => pattern.test(path)); if (match) return match; }
  return paths.find((path) => !TIME.test(path)) ?? paths[0] ?? '';
}

const written = (value) => (value === null || value === undefined ? '–' : Math.abs(value) < 1e-9 ? '0' : Math.abs(value) >= 1e5 || (value && Math.abs(value) < 1e-3) ? value.toExponential(2) : String(Number(value.toPrecision(4))));
const keyOf = (curve) => `${curve.topic} ${curve.path}`;

export class Plots {
  constructor(send, isVisible) {
    this.send = send; this.isVisible = isVisible; this.plots = []; this.samples = new Map(); this.offset = null; this.fields = [];
    $('plot-topic').onchange = () => this.list();
    $('plot-new').onclick = () => this.add(false);
    $('plot-over').onclick = () => this.add(true);
    for (const curves of remembered('plots', [])) if (Array.isArray(curves)) this.plots.push(this.make(curves));
    new ResizeObserver(() => this.draw()).observe($('plot-list'));
    setInterval(() => { if (!document.hidden && this.isVisible()) this.draw(); }, 200);
  }

  setTopics(topics) {
    const select = $('plot-topic'), chosen = select.value;
    select.replaceChildren(new Option('choose a topic', ''), ...topics.map((t) => new Option(t, t, false, t === chosen)));
    if (chosen && !topics.includes(chosen)) this.list();
  }

  list() {
    this.fields = [];
    $('plot-field').replaceChildren();
    this.enable();
    const topic = $('plot-topic').value;
    if (topic) { $('plot-field').append(new Option('listing its fields …', '')); this.send('fields', { topic }); }
  }

  setFields(value) {
    if (value.topic !== $('plot-topic').value) return;
    this.fields = value.fields.map(([path, unit, label]) => ({ topic: value.topic, path, unit, label }));
    const options = this.fields.map((f) => new Option(`${f.path}${f.label ? ` (${f.label})` : ''}${f.unit ? `  ${f.unit}` : ''}`, f.path));
    $('plot-field').replaceChildren(...(options.length ? options : [new Option('no numeric fields', '')]));
    if (options.length) $('plot-field').value = useful(this.fields.map((f) => f.path));
    this.enable();
  }

  enable() {
    const last = this.plots.at(-1);
    $('plot-new').disabled = !this.fields.length;
    $('plot-over').disabled = !this.fields.length || !last || last.curves.length >= MAX_IN_ONE;
  }

  get curves() { return this.plots.flatMap((p) => p.curves); }

  add(over) {
    const field = this.fields.find((f) => f.path === $('plot-field').value), last = this.plots.at(-1);
    if (!field) return;
    if (this.curves.length >= MAX_CURVES) { note(`${MAX_CURVES} curves are plotted already: close one first`, true); return; }
    if (over && last) { if (!last.curves.some((c) => keyOf(c) === keyOf(field))) last.curves.push(field); this.label(last); } else this.plots.push(this.make([field]));
    this.changed();
  }

  make(curves) {
    const plot = { curves, box: element('div', '', { className: 'plot' }), head: element('div', '', { className: 'plot-head' }), canvas: element('canvas') };
    plot.box.append(plot.head, plot.canvas);
    $('plot-list').append(plot.box);
    this.label(plot);
    return plot;
  }

  label(plot) {
    const close = element('button', '×', { title: 'close this plot' });
    close.setAttribute('aria-label', close.title);
    close.onclick = () => { plot.box.remove(); this.plots = this.plots.filter((p) => p !== plot); this.changed(); };
    plot.values = plot.curves.map(() => element('b'));
    plot.head.replaceChildren(...plot.curves.map((c, k) => {
      const span = element('span', '', { title: `${c.topic} ${c.path}` }), mark = element('i');
      mark.style.background = k ? `repeating-linear-gradient(90deg, var(${COLORS[k]}) 0 ${DASHES[k][0]}px, transparent 0 ${DASHES[k][0] + DASHES[k][1]}px)` : `var(${COLORS[k]})`;
      span.append(mark, `${c.topic.replace(/^\//, '')} ${c.label ? `${c.path.replace(/\[\d+\].*/, '')} ${c.label}` : c.path} `, plot.values[k], ` ${c.unit}`);
      return span;
    }), close);
  }

  changed() {
    remember('plots', this.plots.map((p) => p.curves));
    this.enable();
    this.subscribe();
    this.draw();
  }

  // Sends the plotted curves to the server: none while the plots are closed.
  subscribe() {
    const open = this.isVisible() && !document.hidden;
    $('plot-empty').hidden = this.plots.length > 0;
    this.send('plot', { curves: open ? this.curves.map((c) => [c.topic, c.path]) : [] });
  }

  setHistory(value) {
    for (const [topic, path] of value.curves) this.samples.delete(`${topic} ${path}`);
    this.addSamples(value);
  }

  addSamples(value) {
    const offset = value.now - performance.now() / 1000; // the server's clock minus the browser's; the fastest message is the best estimate
    this.offset = this.offset === null || Math.abs(offset - this.offset) > 2 ? offset : Math.max(this.offset, offset);
    for (const [topic, path, samples] of value.curves) {
      const key = `${topic} ${path}`, kept = this.samples.get(key) || [];
      kept.push(...samples);
      while (kept.length && kept[0][0] < value.now - SPAN - 1) kept.shift();
      this.samples.set(key, kept);
    }
  }

  draw() { for (const plot of this.plots) this.paint(plot); }

  paint(plot) {
    const canvas = plot.canvas, c = canvas.getContext('2d'), ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
    if (!w || !h) return;
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio); }
    const style = getComputedStyle(document.documentElement), color = (name) => style.getPropertyValue(name).trim();
    const now = (this.offset ?? 0) + performance.now() / 1000, lines = plot.curves.map((curve) => this.samples.get(keyOf(curve)) || []);
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, w, h);
    let low = Infinity, high = -Infinity;
    for (const line of lines) for (const [t, v] of line) if (v !== null && t > now - SPAN) { low = Math.min(low, v); high = Math.max(high, v); }
    canvas.dataset.samples = lines.reduce((sum, line) => sum + line.length, 0);
    plot.values.forEach((b, k) => { b.textContent = written(lines[k].at(-1)?.[1]); });
    c.font = '11px system-ui, sans-serif'; c.textBaseline = 'middle'; c.fillStyle = color('--soft');
    if (low > high) { c.textAlign = 'center'; c.fillText('no values yet', w / 2, h / 2); return; }
    const least = Math.max(1e-6, 1e-3 * Math.max(Math.abs(low), Math.abs(high)));
    if (high - low < least) { const middle = (low + high) / 2; low = middle - least; high = middle + least; }
    const marks = ticks(low, high), left = 8 + Math.max(...marks.map((m) => c.measureText(written(m)).width)), bottom = 16, top = 6;
    const x = (t) => left + (w - left - 4) * (1 - (now - t) / SPAN), y = (v) => top + (h - bottom - top) * (1 - (v - low) / (high - low));
    c.strokeStyle = color('--line'); c.lineWidth = 1; c.textAlign = 'right'; c.beginPath();
    for (const mark of marks) { c.moveTo(left, Math.round(y(mark)) + 0.5); c.lineTo(w - 4, Math.round(y(mark)) + 0.5); c.fillText(written(mark), left - 4, y(mark)); }
    c.stroke();
    c.textAlign = 'center';
    for (const age of [60, 40, 20]) c.fillText(`−${age} s`, Math.max(x(now - age), left + 14), h - 7);
    c.textAlign = 'right'; c.fillText('now', w - 4, h - 7);
    lines.forEach((line, k) => {
      c.strokeStyle = color(COLORS[k]); c.lineWidth = 1.6; c.lineJoin = 'round'; c.setLineDash(DASHES[k]); c.beginPath();
      let up = true;
      for (const [t, v] of line) {
        if (t < now - SPAN) continue;
        if (v === null) { up = true; continue; }
        up ? c.moveTo(x(t), y(v)) : c.lineTo(x(t), y(v)); up = false;
      }
      c.stroke(); c.setLineDash([]);
    });
  }
}
